#include "gld/tensors/weight_tensors.h"
#include "models/bundle/part_lineage.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/small_training.h"
#include "train/loop/metrics_log.h"
#include "train/objectives/blending_objective.h"
#include "train/stages/feature_stages.h"

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::scenes_of_two_sources;
using test::TemporaryFolder;

BundleOptions blending_model() {
  BundleOptions model = test::small_model();
  model.blending.channels = {6, 8};
  model.blending.side = 56;
  return model;
}

BlendingObjective random_objective(const BlendingObjectiveOptions& options,
                                   const std::shared_ptr<DepthRefinement>& refinement = nullptr) {
  const BundleOptions model = blending_model();
  auto generator = at::detail::createCPUGenerator(3);
  auto backbone = model.backbone.make(ParameterPlacement{});
  backbone->initialise(generator);
  auto head = model.geometry_head.make(ParameterPlacement{});
  head->initialise(generator);
  return {model, options, {backbone, head, refinement}, 1};
}

// By true depth, which is there in every scene; what random weights of a backbone say may be nothing.
BlendingObjectiveOptions by_true_depth() {
  BlendingObjectiveOptions options;
  options.true_depth = 1;
  return options;
}

double loss_after(BlendingObjective& objective, int64_t steps) {
  FlatParameters parameters(objective.parameters());
  Optimiser optimiser(parameters, {});
  const DatasetBatches data(scenes_of_two_sources(), {{56, 56}}, FrameParts::kImageAndDepth);
  const TrainingBatch batch = data.batch(0);
  auto generator = at::detail::createCPUGenerator(2);
  double last = 0;
  for (int64_t step = 0; step < steps; ++step) {
    parameters.zero_gradients();
    const Losses losses = objective.losses(batch, {step, steps, generator});
    losses.total.backward();
    optimiser.step(3e-3, optimiser.gradient_norm());
    last = losses.total.item<double>();
  }
  return last;
}

TEST(BlendingTraining, LearnsToLayPhotographsTogether) {
  BlendingObjectiveOptions options = by_true_depth();
  options.kept_gib = 0.1;
  auto objective = random_objective(options);
  const double first = loss_after(objective, 1);
  EXPECT_LT(loss_after(objective, 40), first - 0.005);
}

TEST(BlendingTraining, WhatIsKeptIsWhatWouldBeMadeAgain) {
  BlendingObjectiveOptions options = by_true_depth();
  auto again = random_objective(options);
  options.kept_gib = 0.1;
  auto kept = random_objective(options);
  const double loss = loss_after(again, 6);
  EXPECT_NE(loss, 0);
  EXPECT_EQ(loss, loss_after(kept, 6));
}

// What photographs are carried by is mended where the model has a network for it.
TEST(BlendingTraining, LearnsOnMendedDepth) {
  PixelUnetOptions network;
  network.channels = {4, 6};
  network.side = 56;
  const auto refinement = std::make_shared<DepthRefinement>(network, ParameterPlacement{});
  refinement->initialise(at::detail::createCPUGenerator(3));
  BlendingObjectiveOptions options;
  options.true_depth = 0;
  auto without = random_objective(options), unchanged = random_objective(options, refinement);
  const double loss = loss_after(without, 1);
  EXPECT_NE(loss, 0);
  EXPECT_EQ(loss_after(unchanged, 1), loss);
  {
    const torch::NoGradGuard no_grad;
    refinement->named_parameters()["correction.bias"].fill_(0.4);
  }
  auto deeper = random_objective(options, refinement);
  EXPECT_NE(loss_after(deeper, 1), loss);
}

// Another run takes it from the folder, rounded as what is kept in memory.
TEST(BlendingTraining, WhatAFolderKeepsIsWhatWouldBeMadeAgain) {
  const TemporaryFolder folder;
  BlendingObjectiveOptions options = by_true_depth();
  const auto loss = [&] {
    auto objective = random_objective(options);
    objective.keep_in(std::make_shared<const KeptFolder>(folder.path(), "test"));
    return loss_after(objective, 6);
  };
  options.kept_gib = 0.1;
  auto in_memory = random_objective(options);
  const double expected = loss_after(in_memory, 6);
  for (const double gib : {0.0, 0.0, 0.1}) {
    options.kept_gib = gib;
    EXPECT_EQ(loss(), expected);
  }
  // It is what is learnt from.
  test::double_kept(folder.path(), "colours");
  options.kept_gib = 0;
  EXPECT_NE(loss(), expected);
}

// Nothing is learnt from it, and nothing breaks.
TEST(BlendingTraining, ASceneWithoutDepthHasNoGradient) {
  BlendingObjectiveOptions options;
  options.true_depth = 0;
  auto objective = random_objective(options);
  TrainingDataOptions one_place = scenes_of_two_sources();
  const DatasetBatches data(one_place, {{56, 56}}, FrameParts::kImage);
  TrainingBatch batch = data.batch(0);
  // Two photographs of one place tell no depth, whoever is asked.
  auto& scene = batch.scenes.front();
  scene.views.cameras[1] = scene.views.cameras[0];
  auto generator = at::detail::createCPUGenerator(2);
  const Losses losses = objective.losses(batch, {0, 1, generator});
  losses.total.backward();
  EXPECT_EQ(losses.total.item<double>(), 0);
  EXPECT_EQ(objective.parameters().front().parameter.grad().abs().max().item<double>(), 0);
}

class BlendingStage : public testing::Test {
 protected:
  BlendingStage() { write_random_bundle(folder_.path() / "bundle", blending_model(), 5); }
  TrainBlendingOptions options(const std::string& out) const {
    auto options =
        test::training_options<TrainBlendingOptions>(folder_.path() / "bundle", folder_.path() / out);
    options.data = scenes_of_two_sources();
    options.loop.learning_rate.warmup_steps = 0;
    options.objective = by_true_depth();
    return options;
  }
  TemporaryFolder folder_;
};

TEST_F(BlendingStage, TwoStepsWriteTheModelWithItsBlending) {
  train_blending(options("run"), {});
  const MetricsLog log(folder_.path() / "run/metrics.jsonl", 2);
  for (const char* key : {"loss", "absolute", "perceptual", "validation_absolute", "validation_psnr",
                          "validation_rule_psnr", "validation_sharpness", "validation_rule_sharpness"}) {
    EXPECT_EQ(log.series(key).size(), 2U) << key;
  }
  for (const auto& point : log.series("absolute")) EXPECT_GT(point.second, 0);
  const auto bundle = ModelBundle::open(folder_.path() / "run/model");
  for (const BundlePart& part : bundle_parts(bundle.options()))
    EXPECT_TRUE(bundle.has(part)) << bundle_part_name(part);
  EXPECT_EQ(bundle.load_blending()->options().channels, blending_model().blending.channels);
}

TEST_F(BlendingStage, StepsInOneCallEqualStepsInSeveral) {
  train_blending(options("whole"), {});
  auto first = options("parts");
  first.loop.steps = 1;
  train_blending(first, {});
  auto second = options("parts");
  second.resume = true;
  train_blending(second, {});
  const auto weights = [&](const std::string& run) {
    return named_parameters(*ModelBundle::open(folder_.path() / run / "model").load_blending());
  };
  const auto whole = weights("whole"), parts = weights("parts");
  const auto start = named_parameters(*ModelBundle::open(folder_.path() / "bundle").load_blending());
  EXPECT_FALSE(torch::equal(whole.front().parameter, start.front().parameter));
  for (size_t i = 0; i < whole.size(); ++i)
    EXPECT_TRUE(torch::equal(whole[i].parameter, parts[i].parameter)) << whole[i].name;
}

// It belongs to what mends depth, also where that came later.
TEST_F(BlendingStage, BelongsToTheNetworkThatMendsDepth) {
  BundleOptions model = blending_model();
  model.depth_refinement.channels = {4, 6};
  const auto bundle = folder_.path() / "mending";
  write_random_bundle(bundle, model, 5);
  const auto trained = [&](const std::string& out) {
    auto asked = options(out);
    asked.model = bundle.string();
    train_blending(asked, {});
    return ModelBundle::open(folder_.path() / out / "model");
  };
  const ModelBundle with = trained("with");
  EXPECT_EQ(mixed_parts(with, {BundlePart::blending()}, false), std::vector<std::string>());
  const auto file = ModelBundle::open(bundle).file(BundlePart::depth_refinement());
  const auto network = read_all(file);
  std::filesystem::remove(file);
  const ModelBundle later = trained("later");
  EXPECT_EQ(mixed_parts(later, {BundlePart::blending()}, false), std::vector<std::string>());
  save_safetensors(later.file(BundlePart::depth_refinement()), network);
  EXPECT_EQ(error_of([&] { mixed_parts(later, {BundlePart::blending()}, false); }),
            later.file(BundlePart::blending()).string() +
                ": expected a part that was trained on the depth_refinement beside it, found one of another "
                "depth_refinement; train blending again, or take it as it is with --allow-mixed.");
}

TEST_F(BlendingStage, RefusesScenesOfOneSourceAndModelsWithoutBlending) {
  auto single = options("single");
  single.data.views.fewest_sources = 1;
  EXPECT_EQ(error_of([&] { train_blending(single, {}); }),
            "--fewest-sources: expected at least 2, which tell the unit of depth, found 1; raise it.");
  auto validated = options("validated");
  validated.data.validation_sources = 1;
  EXPECT_EQ(
      error_of([&] { train_blending(validated, {}); }),
      "--validation-sources: expected 0 or at least 2, which tell the unit of depth, found 1; raise it.");
  auto without = options("without");
  without.model = (folder_.path() / "other").string();
  save_bundle_options(without.model, test::small_model());
  EXPECT_EQ(
      error_of([&] { train_blending(without, {}); }),
      without.model +
          "/model.yaml: expected a blending part, found none; add for example blending: {channels: [24, 32, "
          "48, 64]}.");
}

}  // namespace
}  // namespace gld
