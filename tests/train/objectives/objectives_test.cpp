// Two steps of every kind of training with a shrunken configuration, and what each objective promises.
#include "models/bundle/bundle.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/small_training.h"
#include "train/loop/checkpoint.h"
#include "train/loop/metrics_log.h"
#include "train/objectives/backbone_objective.h"
#include "train/objectives/decoder_objective.h"
#include "train/objectives/feature_noise.h"
#include "train/objectives/geometry_loss.h"
#include "train/objectives/scene_pixels.h"

#include <cmath>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

TrainingRun run_of(const std::filesystem::path& folder, Objective& objective) {
  const auto model = test::small_model();
  TrainingRun run;
  run.folder = folder;
  run.objective = &objective;
  run.data =
      std::make_shared<LoadedBatches>(test::small_data(), model.image_sizes(), FrameParts::kImageAndDepth);
  run.validation_scenes =
      validation_scenes(test::small_data(), model.image_sizes().front(), FrameParts::kImageAndDepth);
  return run;
}

void expect_metrics(const std::filesystem::path& folder, const std::vector<std::string>& keys) {
  const MetricsLog log(folder / "metrics.jsonl", 2);
  for (const std::string& key : keys) {
    const auto series = log.series(key);
    ASSERT_EQ(series.size(), 2U) << key;
    for (const auto& point : series) EXPECT_TRUE(std::isfinite(point.second)) << key;
  }
  EXPECT_TRUE(std::filesystem::exists(folder / "loss.svg"));
}

TEST(BackboneTraining, TwoSteps) {
  const test::TemporaryFolder folder;
  BackboneObjective objective(test::small_model(), {}, {}, 1);
  const auto summary = train(run_of(folder.path(), objective), test::two_steps(), TrainingStart::kFresh);
  EXPECT_EQ(summary.skipped_steps, 0);
  expect_metrics(folder.path(), {"depth", "rays", "points", "pixels_level0", "pixels_level1", "depth_abs_rel",
                                 "validation_geometry_loss", "validation_pixel_psnr"});
  const auto bundle = ModelBundle::open(folder.path() / "model");
  EXPECT_TRUE(bundle.has(BundlePart::kBackbone));
  EXPECT_TRUE(bundle.has(BundlePart::kDptHead));
  EXPECT_EQ(bundle.load_backbone()->options().embed_dim, 32);
}

TEST(BackboneTraining, LearnsDepthAndColourOfAFewScenes) {
  BackboneObjective objective(test::small_model(), {}, {}, 1);
  FlatParameters parameters(objective.parameters());
  Optimiser optimiser(parameters, {});
  const LoadedBatches data(test::small_data(), {{56, 56}}, FrameParts::kImageAndDepth);
  const TrainingBatch batch = data.batch(0);
  auto generator = at::detail::createCPUGenerator(2);
  double first = 0.0, last = 0.0;
  for (int64_t step = 0; step < 40; ++step) {
    parameters.zero_gradients();
    const Losses losses = objective.losses(batch, {step, 40, generator});
    losses.total.backward();
    optimiser.step(2e-3, optimiser.gradient_norm());
    (step == 0 ? first : last) = losses.total.item<double>();
  }
  EXPECT_LT(last, 0.7 * first);
}

TEST(BackboneTraining, NeedsDepth) {
  BackboneObjective objective(test::small_model(), {}, {}, 1);
  const LoadedBatches data(test::small_data(), {{56, 56}}, FrameParts::kImage);
  auto batch = data.batch(0);
  batch.scenes[0].name = "kitchen";
  auto generator = at::detail::createCPUGenerator(2);
  EXPECT_EQ(
      test::error_of([&] {
        objective.losses(batch, {0, 1, generator});
      }),
      "scene kitchen: expected depth to train the backbone with, found none; use scenes with depth, such as "
      "those of gld synth.");
}

TEST(GeometryTargets, RaysTimesDepthAreThePointsInTheFirstCamera) {
  const LoadedBatches data(test::small_data(), {{56, 56}}, FrameParts::kImageAndDepth);
  const TrainingScene scene = data.batch(3).scenes.front();
  const GeometryTargets targets = geometry_targets(scene, {14, 14});
  EXPECT_TRUE(torch::equal(targets.rays[0].narrow(2, 3, 3), torch::zeros({14, 14, 3})));
  // Cell (2, 5) covers rows 8 to 11 and columns 20 to 23; its middle is the corner of pixel (10, 22).
  const Camera& camera = scene.views.cameras[1];
  const Eigen::Vector3d in_camera = camera.intrinsics.inverse() * Eigen::Vector3d(22.0, 10.0, 1.0) *
                                    static_cast<double>(scene.depth[1][10][22].item<float>());
  const Eigen::Vector3d expected =
      scene.views.cameras[0].camera_from_world() * (camera.world_from_camera * in_camera);
  const auto ray = targets.rays[1][2][5];
  for (int axis = 0; axis < 3; ++axis) {
    const double point =
        (ray[axis] * targets.ray_depth[1][2][5] + ray[axis + 3]).item<double>() * targets.scale;
    EXPECT_NEAR(point, expected[axis], 1e-4);
  }
}

TEST(GeometryLoss, TheRelativeErrorIsAddedWithItsWeight) {
  GeometryTargets targets;
  targets.depth = torch::tensor({1.0F, 2.0F, 4.0F, 9.0F}).view({1, 2, 2});
  targets.valid = torch::tensor({true, true, true, false}).view({1, 2, 2});
  targets.rays = torch::zeros({1, 1, 1, 6});
  targets.ray_depth = torch::ones({1, 1, 1});
  targets.ray_valid = torch::ones({1, 1, 1}, torch::kBool);
  GeometryOutput predicted;
  predicted.depth = torch::tensor({1.5F, 2.5F, 3.0F, 1.0F}).view({1, 2, 2}).requires_grad_(true);
  predicted.depth_confidence = torch::ones({1, 2, 2});
  predicted.rays = torch::zeros({1, 1, 1, 6});
  predicted.ray_confidence = torch::ones({1, 1, 1});
  GeometryLossOptions options;
  const auto without = geometry_losses(predicted, targets, options);
  options.relative_weight = 3;
  const auto with = geometry_losses(predicted, targets, options);
  const double relative = (0.5 + 0.25 + 0.25) / 3;
  EXPECT_NEAR(with.absolute_relative.item<double>(), relative, 1e-6);
  EXPECT_NEAR((with.total - without.total).item<double>(), 3 * relative, 1e-6);
  (with.total - without.total).backward();
  // 3 / (3 pixels * true depth), towards the truth; nothing where it is unknown.
  const auto expected = torch::tensor({1.0F, 0.5F, -0.25F, 0.0F}).view({1, 2, 2});
  EXPECT_LT((predicted.depth.grad() - expected).abs().max().item<double>(), 1e-6);
}

TEST(FeatureNoise, HasTheDeviationOfEachChannelTimesOneStrength) {
  auto generator = at::detail::createCPUGenerator(5), same = at::detail::createCPUGenerator(5);
  const auto scales = torch::tensor({0.1F, 1.0F, 20.0F});
  const std::vector<torch::Tensor> levels{torch::randn({4, 2000, 3}) * scales + 7,
                                          torch::randn({4, 2000, 3})};
  const auto noisy = with_feature_noise(levels, 0.5, generator);
  const double strength = std::abs(torch::randn({1}, same, torch::kFloat64).item<double>()) * 0.5;
  for (size_t level = 0; level < levels.size(); ++level) {
    const auto added =
        (noisy[level] - levels[level]).flatten(0, 1).std(0) / levels[level].flatten(0, 1).std(0);
    EXPECT_LT((added - strength).abs().max().item<double>(), 0.05 * strength) << level;
  }
  const auto untouched = with_feature_noise(levels, 0, generator);
  EXPECT_TRUE(untouched[0].is_same(levels[0]));
}

DecoderObjectiveOptions small_decoder() {
  DecoderObjectiveOptions options;
  options.adversarial.convolutional.channels = 8;
  options.adversarial.crop = 32;
  options.latent_noise = 0.1;
  return options;
}

std::shared_ptr<Da3Backbone> random_backbone() {
  auto backbone = std::make_shared<Da3Backbone>(test::small_model().backbone, ParameterPlacement{});
  backbone->initialise(at::detail::createCPUGenerator(3));
  return backbone;
}

TEST(DecoderTraining, TwoStepsWithADiscriminator) {
  const test::TemporaryFolder folder;
  DecoderObjective objective(test::small_model(), small_decoder(), random_backbone(), {}, 1);
  const auto summary = train(run_of(folder.path(), objective), test::two_steps(), TrainingStart::kFresh);
  EXPECT_EQ(summary.skipped_steps, 0);
  expect_metrics(folder.path(), {"reconstruction", "perceptual", "adversarial", "adaptive_weight",
                                 "discriminator", "discriminator_accuracy", "validation_psnr"});
  EXPECT_TRUE(ModelBundle::open(folder.path() / "model").has(BundlePart::kRgbDecoder));
}

TEST(DecoderTraining, StepsInOneCallEqualStepsInSeveralWithADiscriminator) {
  const test::TemporaryFolder whole, parts;
  auto options = test::two_steps();
  options.steps = 3;
  for (const auto* folder : {&whole, &parts}) {
    DecoderObjective objective(test::small_model(), small_decoder(), random_backbone(), {}, 1);
    train(run_of(folder->path(), objective), options, TrainingStart::kFresh);
  }
  for (const char* late : {"step_000000002.safetensors", "step_000000003.safetensors"}) {
    std::filesystem::remove(parts.path() / "checkpoints" / late);
  }
  DecoderObjective objective(test::small_model(), small_decoder(), random_backbone(), {}, 99);
  train(run_of(parts.path(), objective), options, TrainingStart::kResume);
  const auto a = load_checkpoint(whole.path() / "checkpoints" / "step_000000003.safetensors").tensors;
  const auto b = load_checkpoint(parts.path() / "checkpoints" / "step_000000003.safetensors").tensors;
  ASSERT_EQ(a.size(), b.size());
  for (const auto& [name, tensor] : a) EXPECT_TRUE(torch::equal(tensor, b.at(name))) << name;
  EXPECT_EQ(a.count("objective.discriminator.layer0.weight_u"), 1U);
}

TEST(DecoderTraining, StartStepsDelayThePartsOfTheLoss) {
  auto options = small_decoder();
  options.perceptual.start = 5;
  options.adversarial.generator_start = 6;
  options.adversarial.discriminator_start = 7;
  DecoderObjective objective(test::small_model(), options, random_backbone(), {}, 1);
  const LoadedBatches data(test::small_data(), {{56, 56}}, FrameParts::kImage);
  auto generator = at::detail::createCPUGenerator(2);
  for (const auto& [step, parts] : std::vector<std::pair<int64_t, size_t>>{{4, 1}, {5, 2}, {6, 4}}) {
    EXPECT_EQ(objective.losses(data.batch(0), {step, 10, generator}).parts.size(), parts) << step;
    EXPECT_TRUE(objective.after_step({step, 10, generator}).empty());
  }
  EXPECT_EQ(objective.after_step({7, 10, generator}).size(), 2U);
}

TEST(ScenePixels, PatchesAndImagesAreInverse) {
  const auto images = torch::arange(2 * 3 * 28 * 42, torch::kFloat32).view({2, 3, 28, 42});
  const auto patches = image_patches(images, 14);
  EXPECT_EQ(patches.sizes(), (std::vector<int64_t>{2, 6, 588}));
  EXPECT_TRUE(torch::equal(image_of_patches(patches, {2, 2, 3}, 14), images));
  // Second pixel of the second patch, green.
  EXPECT_EQ(patches[0][1][3 + 1].item<float>(), images[0][1][0][15].item<float>());
}

TEST(ScenePixels, PsnrIsThatOfItsDefinition) {
  const auto truth = torch::full({2, 3, 8, 8}, 0.5);
  EXPECT_NEAR(mean_psnr(truth + 0.1, truth), 20.0, 1e-4);
  EXPECT_EQ(mean_psnr(truth, truth), 100.0);
}

}  // namespace
}  // namespace gld
