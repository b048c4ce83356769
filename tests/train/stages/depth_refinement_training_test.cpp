#include "models/bundle/random_bundle.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/small_training.h"
#include "train/loop/metrics_log.h"
#include "train/objectives/depth_refinement_objective.h"
#include "train/stages/feature_stages.h"

#include <filesystem>
#include <memory>
#include <string>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::scenes_of_two_sources;
using test::TemporaryFolder;

BundleOptions refining_model() {
  BundleOptions model = test::small_model();
  model.depth_refinement.channels = {6, 8};
  model.depth_refinement.side = 56;
  return model;
}

DepthRefinementObjective random_refinement(const DepthRefinementObjectiveOptions& options) {
  const BundleOptions model = refining_model();
  auto generator = at::detail::createCPUGenerator(3);
  auto backbone = model.backbone.make(ParameterPlacement{});
  backbone->initialise(generator);
  auto head = model.geometry_head.make(ParameterPlacement{});
  head->initialise(generator);
  return {model, options, backbone, head, 1};
}

struct Mended {
  double loss = 0;
  double absolute = 0, absolute_before = 0;
};

Mended mended(DepthRefinementObjective& objective, int64_t steps) {
  FlatParameters parameters(objective.parameters());
  Optimiser optimiser(parameters, {});
  const DatasetBatches data(scenes_of_two_sources(), {{56, 56}}, FrameParts::kImageAndDepth);
  const TrainingBatch batch = data.batch(0);
  auto generator = at::detail::createCPUGenerator(2);
  Mended last;
  for (int64_t step = 0; step < steps; ++step) {
    parameters.zero_gradients();
    const Losses losses = objective.losses(batch, {step, steps, generator});
    losses.total.backward();
    optimiser.step(3e-3, optimiser.gradient_norm());
    last.loss = losses.total.item<double>();
    for (const auto& [name, value] : losses.parts) {
      if (name == "absolute") last.absolute = value.item<double>();
      if (name == "absolute_before") last.absolute_before = value.item<double>();
    }
  }
  return last;
}

TEST(DepthRefinementTraining, LearnsToMendDepth) {
  DepthRefinementObjectiveOptions options;
  options.kept_gib = 0.1;
  auto objective = random_refinement(options);
  const Mended first = mended(objective, 1);
  ASSERT_GT(first.absolute_before, 0.05);
  EXPECT_NEAR(first.absolute, first.absolute_before, 1e-5);
  EXPECT_LT(mended(objective, 40).absolute, 0.7 * first.absolute_before);
}

TEST(DepthRefinementTraining, WhatIsKeptIsWhatWouldBeMadeAgain) {
  DepthRefinementObjectiveOptions options;
  auto again = random_refinement(options);
  options.kept_gib = 0.1;
  auto kept = random_refinement(options);
  const double loss = mended(again, 3).loss;
  EXPECT_NE(loss, 0);
  EXPECT_EQ(mended(kept, 3).loss, loss);
}

// Another run takes it from the folder, rounded as what is kept in memory.
TEST(DepthRefinementTraining, WhatAFolderKeepsIsWhatWouldBeMadeAgain) {
  const TemporaryFolder folder;
  DepthRefinementObjectiveOptions options;
  const auto loss = [&] {
    auto objective = random_refinement(options);
    objective.keep_in(std::make_shared<const KeptFolder>(folder.path(), "test"));
    return mended(objective, 3).loss;
  };
  options.kept_gib = 0.1;
  auto in_memory = random_refinement(options);
  const double expected = mended(in_memory, 3).loss;
  for (const double gib : {0.0, 0.0, 0.1}) {
    options.kept_gib = gib;
    EXPECT_EQ(loss(), expected);
  }
  // It is what is learnt from.
  test::double_kept(folder.path(), "off");
  options.kept_gib = 0;
  EXPECT_NE(loss(), expected);
}

// Nothing is learnt from it, and nothing breaks.
TEST(DepthRefinementTraining, ASceneWithoutDepthHasNoGradient) {
  auto objective = random_refinement({});
  const DatasetBatches data(scenes_of_two_sources(), {{56, 56}}, FrameParts::kImageAndDepth);
  TrainingBatch batch = data.batch(0);
  // Two photographs of one place tell no depth, whoever is asked.
  auto& scene = batch.scenes.front();
  scene.views.cameras[1] = scene.views.cameras[0];
  auto generator = at::detail::createCPUGenerator(2);
  const Losses losses = objective.losses(batch, {0, 1, generator});
  losses.total.backward();
  EXPECT_EQ(losses.total.item<double>(), 0);
  for (const NamedParameter& parameter : objective.parameters()) {
    const auto gradient = parameter.parameter.grad();
    if (!gradient.defined()) continue;
    EXPECT_EQ(gradient.abs().max().item<double>(), 0) << parameter.name;
  }
  // The same scene with its depth has a gradient.
  batch = data.batch(0);
  objective.losses(batch, {0, 1, generator}).total.backward();
  EXPECT_EQ(objective.parameters().back().name, "correction.bias");
  EXPECT_NE(objective.parameters().back().parameter.grad().item<double>(), 0);
}

TEST(DepthRefinementTraining, AsksForTrueDepth) {
  auto objective = random_refinement({});
  const DatasetBatches data(scenes_of_two_sources(), {{56, 56}}, FrameParts::kImage);
  const TrainingBatch batch = data.batch(0);
  auto generator = at::detail::createCPUGenerator(2);
  EXPECT_EQ(
      error_of([&] {
        objective.losses(batch, {0, 1, generator});
      }),
      "scene " + batch.scenes.front().name +
          ": expected depth to train its mending with, found none; use scenes with depth, such as those of gld "
          "synth.");
}

class DepthRefinementStage : public testing::Test {
 protected:
  DepthRefinementStage() { write_random_bundle(folder_.path() / "bundle", refining_model(), 5); }
  TrainDepthOptions options(const std::string& out) const {
    auto options = test::training_options<TrainDepthOptions>(folder_.path() / "bundle", folder_.path() / out);
    options.data = scenes_of_two_sources();
    options.loop.learning_rate.warmup_steps = 0;
    return options;
  }
  TemporaryFolder folder_;
};

TEST_F(DepthRefinementStage, TwoStepsWriteTheModelWithItsRefinement) {
  train_depth(options("run"), {});
  const MetricsLog log(folder_.path() / "run/metrics.jsonl", 2);
  for (const char* key :
       {"loss", "absolute", "edges", "absolute_before", "validation_abs_rel", "validation_abs_rel_before",
        "validation_abs_rel_shared", "validation_abs_rel_shared_before", "validation_abs_rel_alone",
        "validation_abs_rel_alone_before", "validation_carried_psnr", "validation_carried_psnr_before"}) {
    EXPECT_EQ(log.series(key).size(), 2U) << key;
  }
  const auto bundle = ModelBundle::open(folder_.path() / "run/model");
  for (const BundlePart& part : bundle_parts(bundle.options()))
    EXPECT_TRUE(bundle.has(part)) << bundle_part_name(part);
  EXPECT_EQ(bundle.load_depth_refinement()->options().channels, refining_model().depth_refinement.channels);
}

TEST_F(DepthRefinementStage, StepsInOneCallEqualStepsInSeveral) {
  train_depth(options("whole"), {});
  auto first = options("parts");
  first.loop.steps = 1;
  train_depth(first, {});
  auto second = options("parts");
  second.resume = true;
  train_depth(second, {});
  const auto weights = [&](const std::string& run) {
    return named_parameters(*ModelBundle::open(folder_.path() / run / "model").load_depth_refinement());
  };
  const auto whole = weights("whole"), parts = weights("parts");
  const auto start = named_parameters(*ModelBundle::open(folder_.path() / "bundle").load_depth_refinement());
  EXPECT_FALSE(torch::equal(whole.back().parameter, start.back().parameter));
  for (size_t i = 0; i < whole.size(); ++i)
    EXPECT_TRUE(torch::equal(whole[i].parameter, parts[i].parameter)) << whole[i].name;
}

TEST_F(DepthRefinementStage, RefusesScenesOfOneSourceAndModelsWithoutTheNetwork) {
  auto single = options("single");
  single.data.views.fewest_sources = 1;
  EXPECT_EQ(error_of([&] { train_depth(single, {}); }),
            "--fewest-sources: expected at least 2, which tell the unit of depth, found 1; raise it.");
  auto without = options("without");
  without.model = (folder_.path() / "other").string();
  save_bundle_options(without.model, test::small_model());
  EXPECT_EQ(error_of([&] { train_depth(without, {}); }),
            without.model +
                "/model.yaml: expected a depth_refinement part, found none; add for example "
                "depth_refinement: {channels: [24, 32, 48, 64]}.");
}

}  // namespace
}  // namespace gld
