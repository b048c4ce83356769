// This runs two steps of every kind of training with a shrunken configuration, and tests what each objective promises.
#include "datasets/scenes/frame_checks.h"
#include "gld/metrics/image_metrics.h"
#include "models/bundle/bundle.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/small_training.h"
#include "train/loop/checkpoint.h"
#include "train/loop/metrics_log.h"
#include "train/objectives/backbone_objective.h"
#include "train/objectives/decoder_objective.h"
#include "train/objectives/feature_noise.h"
#include "train/objectives/scene_pixels.h"

#include <algorithm>
#include <cmath>
#include <map>

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
      std::make_shared<DatasetBatches>(test::small_data(), model.image_sizes(), FrameParts::kImageAndDepth);
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
  expect_metrics(folder.path(),
                 {"depth", "rays", "points", "pixels_level0", "pixels_level1", "depth_abs_rel",
                  "validation_geometry_loss", "validation_pixel_error", "validation_pixel_psnr"});
  const auto bundle = ModelBundle::open(folder.path() / "model");
  EXPECT_TRUE(bundle.has(BundlePart::backbone()));
  EXPECT_TRUE(bundle.has(BundlePart::geometry_head()));
  EXPECT_EQ(bundle.load_backbone()->architecture().level_channels(), 64);
}

TEST(BackboneTraining, LearnsDepthAndColourOfAFewScenes) {
  BackboneObjective objective(test::small_model(), {}, {}, 1);
  FlatParameters parameters(objective.parameters());
  Optimiser optimiser(parameters, {});
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImageAndDepth);
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
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImage);
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

TEST(BackboneTraining, ASceneWithoutKnownDepthTeachesNoGeometry) {
  BackboneObjectiveOptions options;
  options.pixel_weights = {};
  options.geometry_weights = {0, 1};
  BackboneObjective objective(test::small_model(), options, {}, 1);
  const FlatParameters parameters(objective.parameters());
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImageAndDepth);
  TrainingBatch batch = data.batch(0);
  for (TrainingScene& scene : batch.scenes) scene.depth.zero_();
  auto generator = at::detail::createCPUGenerator(2);
  const Losses losses = objective.losses(batch, {0, 1, generator});
  losses.total.backward();
  EXPECT_EQ(losses.total.item<double>(), 0);
  EXPECT_TRUE(losses.parts.empty());
  EXPECT_EQ(parameters.gradients().abs().max().item<double>(), 0);
  const torch::NoGradGuard no_grad;
  EXPECT_EQ(test::error_of([&] { objective.validate(batch.scenes); }),
            "validation of a backbone: expected a scene with pixels of known depth, found none among " +
                std::to_string(batch.scenes.size()) +
                "; give others with --validation-folder, or none with --validation-scenes 0.");
}

TEST(BackboneTraining, LearnsFromTokensAndCorrespondenceWithoutTheHead) {
  BackboneObjectiveOptions options;
  options.head_probability = 0;
  options.geometry_weights = {0, 1, 0, 1};
  options.correspondence_weight = 0.1;
  options.correspondence_blocks = {3};
  options.all_views_probability = 1;
  BackboneObjective objective(test::small_model(), options, {}, 1);
  FlatParameters parameters(objective.parameters());
  OptimiserOptions muon;
  muon.algorithm = OptimiserAlgorithm::kMuon;
  Optimiser optimiser(parameters, muon);
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImageAndDepth);
  const TrainingBatch batch = data.batch(0);
  auto generator = at::detail::createCPUGenerator(2);
  std::map<std::string, double> first, last;
  for (int64_t step = 0; step < 60; ++step) {
    parameters.zero_gradients();
    const Losses losses = objective.losses(batch, {step, 60, generator});
    losses.total.backward();
    optimiser.step(2e-3, optimiser.gradient_norm());
    for (const auto& [name, value] : losses.parts) (step == 0 ? first : last)[name] = value.item<double>();
  }
  EXPECT_EQ(first.count("depth"), 0U);
  for (const char* part : {"geometry_level1", "geometry_level3", "correspondence"}) {
    EXPECT_LT(last.at(part), 0.7 * first.at(part)) << part;
  }
  const torch::NoGradGuard no_grad;
  std::map<std::string, double> validation;
  for (const auto& [name, value] : objective.validate(batch.scenes).values) validation[name] = value;
  for (const char* name : {"direction_degrees", "rotation_degrees", "translation_degrees", "origin_error",
                           "level1_rotation_degrees", "level3_origin_error", "correspondence"}) {
    EXPECT_TRUE(std::isfinite(validation.at(name))) << name;
  }
  options.correspondence_blocks = {};
  EXPECT_EQ(
      test::error_of([&] { BackboneObjective(test::small_model(), options, {}, 1); }),
      "objective.correspondence_weight: expected 0 without correspondence_blocks, whose attention it would "
      "teach, found 0.1; name blocks, or leave it out.");
  options.correspondence_blocks = {4};
  EXPECT_EQ(
      test::error_of([&] { BackboneObjective(test::small_model(), options, {}, 1); }),
      "objective.correspondence_blocks: expected blocks below 8 that attend over all views, found 4; choose "
      "others.");
}

BundleOptions model_of_known_cameras() {
  BundleOptions model = test::small_model();
  auto& backbone = model.backbone.as<Da3BackboneOptions>();
  backbone.camera_encoder_depth = 1;
  backbone.camera_encoder_heads = 2;
  model.geometry_head.as<DptHeadOptions>().camera_decoder = true;
  return model;
}

// Returns how far training of 60 steps on one batch changed each tensor that is trained.
std::map<std::string, double> changed(const BackboneObjectiveOptions& options,
                                      std::map<std::string, double>& validation) {
  BackboneObjective objective(model_of_known_cameras(), options, {}, 1);
  std::map<std::string, torch::Tensor> before;
  for (const auto& parameter : objective.parameters())
    before[parameter.name] = parameter.parameter.detach().clone();
  FlatParameters parameters(objective.parameters());
  Optimiser optimiser(parameters, {});
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImageAndDepth);
  const TrainingBatch batch = data.batch(0);
  auto generator = at::detail::createCPUGenerator(2);
  for (int64_t step = 0; step < 60; ++step) {
    parameters.zero_gradients();
    const Losses losses = objective.losses(batch, {step, 60, generator});
    losses.total.backward();
    optimiser.step(2e-3, optimiser.gradient_norm());
  }
  std::map<std::string, double> changes;
  for (const auto& parameter : objective.parameters()) {
    const auto change = parameter.parameter.detach() - before.at(parameter.name);
    changes[parameter.name] = change.abs().max().item<double>();
  }
  const torch::NoGradGuard no_grad;
  for (const auto& [name, value] : objective.validate(batch.scenes).values) validation[name] = value;
  return changes;
}

TEST(BackboneTraining, KnownCamerasAreToldAndDecoded) {
  BackboneObjectiveOptions options;
  options.all_views_probability = 1;
  options.known_cameras = 0.5;
  options.loss.camera_weight = 1;
  std::map<std::string, double> validation;
  const auto changes = changed(options, validation);
  int64_t of_encoder = 0, of_decoder = 0;
  for (const auto& [name, change] : changes) {
    const bool encoder = name.find("cam_enc.") != std::string::npos;
    const bool decoder = name.find("cam_dec.") != std::string::npos;
    if (!encoder && !decoder) continue;
    ++(encoder ? of_encoder : of_decoder);
    EXPECT_GT(change, 0) << name;
  }
  EXPECT_GT(of_encoder, 10);
  EXPECT_GT(of_decoder, 6);
  for (const std::string prefix : {"", "known_cameras_"}) {
    for (const char* name : {"depth_abs_rel", "rotation_degrees", "origin_error", "camera_error"})
      EXPECT_TRUE(std::isfinite(validation.at(prefix + name))) << prefix << name;
  }
  // What is told is not what is found.
  EXPECT_NE(validation.at("known_cameras_rotation_degrees"), validation.at("rotation_degrees"));
  EXPECT_LT(validation.at("camera_error"), 0.2);
}

// Attention is taught with cameras told as with cameras found.
TEST(BackboneTraining, CorrespondenceIsTaughtWithKnownCameras) {
  BackboneObjectiveOptions options;
  options.known_cameras = 0.9;
  options.correspondence_weight = 0.1;
  options.correspondence_blocks = {3};
  options.all_views_probability = 1;
  BackboneObjective objective(model_of_known_cameras(), options, {}, 1);
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImageAndDepth);
  const TrainingBatch batch = data.batch(0);
  auto generator = at::detail::createCPUGenerator(2);
  for (int64_t step = 0; step < 8; ++step) {  // of which nearly all are told
    const auto parts = objective.losses(batch, {step, 8, generator}).parts;
    EXPECT_TRUE(std::any_of(parts.begin(), parts.end(), [](const auto& part) {
      return part.first == "correspondence";
    })) << step;
  }
}

TEST(BackboneTraining, WhatNobodyIsToldStaysAsItWas) {
  BackboneObjectiveOptions options;
  std::map<std::string, double> validation;
  for (const auto& entry : changed(options, validation)) {
    EXPECT_EQ(entry.first.find("cam_enc."), std::string::npos) << entry.first;
    EXPECT_EQ(entry.first.find("cam_dec."), std::string::npos) << entry.first;
  }
  EXPECT_EQ(validation.count("known_cameras_depth_abs_rel"), 0U);
  options.known_cameras = 0.2;
  EXPECT_EQ(
      test::error_of([&] { BackboneObjective(test::small_model(), options, {}, 1); }),
      "objective.known_cameras: expected 0 for a backbone without an encoder of cameras, found 0.2; give "
      "the model one (backbone.camera_encoder_depth), or leave it out.");
}

// The best checkpoint is the one with the least of the first value.
TEST(BackboneTraining, ValidationsBeginWithAnError) {
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImageAndDepth);
  const auto scenes = data.batch(0).scenes;
  auto model = test::small_model();
  const torch::NoGradGuard no_grad;
  EXPECT_EQ(BackboneObjective(model, {}, {}, 1).validate(scenes).values.front().first, "geometry_loss");
  model.geometry_head = GeometryHeadOptions::none();
  BackboneObjective of_pixels(model, {}, {}, 1);
  const auto values = of_pixels.validate(scenes).values;
  ASSERT_EQ(values.size(), 2U);
  EXPECT_EQ(values[0].first, "pixel_error");
  EXPECT_EQ(values[1].first, "pixel_psnr");
  EXPECT_GT(values[0].second, 0);
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

std::shared_ptr<Backbone> random_backbone() {
  auto backbone = test::small_model().backbone.make(ParameterPlacement{});
  backbone->initialise(at::detail::createCPUGenerator(3));
  return backbone;
}

TEST(DecoderTraining, TwoStepsWithADiscriminator) {
  const test::TemporaryFolder folder;
  DecoderObjective objective(test::small_model(), small_decoder(), random_backbone(), {}, 1);
  const auto summary = train(run_of(folder.path(), objective), test::two_steps(), TrainingStart::kFresh);
  EXPECT_EQ(summary.skipped_steps, 0);
  expect_metrics(folder.path(),
                 {"reconstruction", "perceptual", "adversarial", "adaptive_weight", "discriminator",
                  "discriminator_accuracy", "validation_psnr", "validation_sharpness"});
  EXPECT_TRUE(ModelBundle::open(folder.path() / "model").has(BundlePart::rgb_decoder()));
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

TEST(DecoderTraining, WorkersTrainADiscriminatorToTheSameBitsEveryTime) {
  const test::TemporaryFolder first, second;
  auto options = test::two_steps();
  options.micro_batches = 3;
  options.workers = 3;
  for (const auto* folder : {&first, &second}) {
    DecoderObjective objective(test::small_model(), small_decoder(), random_backbone(), {}, 1);
    const auto summary = train(run_of(folder->path(), objective), options, TrainingStart::kFresh);
    EXPECT_TRUE(summary.messages.empty());
  }
  const auto a = load_checkpoint(first.path() / "checkpoints" / "step_000000002.safetensors").tensors;
  const auto b = load_checkpoint(second.path() / "checkpoints" / "step_000000002.safetensors").tensors;
  ASSERT_EQ(a.size(), b.size());
  for (const auto& [name, tensor] : a) EXPECT_TRUE(torch::equal(tensor, b.at(name))) << name;
}

TEST(DecoderTraining, StartStepsDelayThePartsOfTheLoss) {
  auto options = small_decoder();
  options.perceptual.start = 5;
  options.adversarial.generator_start = 6;
  options.adversarial.discriminator_start = 7;
  DecoderObjective objective(test::small_model(), options, random_backbone(), {}, 1);
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImage);
  auto generator = at::detail::createCPUGenerator(2);
  for (const auto& [step, parts] : std::vector<std::pair<int64_t, size_t>>{{4, 1}, {5, 2}, {6, 4}}) {
    EXPECT_EQ(objective.losses(data.batch(0), {step, 10, generator}).parts.size(), parts) << step;
    EXPECT_TRUE(objective.after_step({step, 10, generator}).empty());
  }
  objective.losses(data.batch(0), {7, 10, generator});
  EXPECT_EQ(objective.after_step({7, 10, generator}).size(), 2U);
}

// A decoder without anything random in its loss, so that only the images decide how the discriminator moves.
DecoderObjectiveOptions quiet_decoder() {
  auto options = small_decoder();
  options.level_dropout = 0;
  options.latent_noise = 0;
  options.adversarial.crop = 56;
  options.adversarial.augment.probability = 0;
  options.adversarial.generator_start = 1000;
  return options;
}

// Returns the discriminator's weights, without the vectors of its spectral normalisation.
std::map<std::string, torch::Tensor> discriminator_weights(const DecoderObjective& objective) {
  std::map<std::string, torch::Tensor> weights;
  for (const auto& [name, tensor] : objective.state()) {
    const std::string end = name.substr(name.size() - 2);
    const bool vector = end == "_u" || end == "_v";
    if (name.rfind("discriminator.", 0) == 0 && !vector) weights[name] = tensor.clone();
  }
  return weights;
}

double largest_difference(const std::map<std::string, torch::Tensor>& a,
                          const std::map<std::string, torch::Tensor>& b) {
  double largest = 0;
  for (const auto& [name, tensor] : a) {
    largest = std::max(largest, (tensor - b.at(name)).abs().max().item<double>());
  }
  return largest;
}

TEST(DecoderTraining, TheDiscriminatorWarmsUpFromItsOwnFirstStep) {
  auto options = quiet_decoder();
  options.adversarial.discriminator_start = 64;
  options.adversarial.learning_rate = {};
  options.adversarial.learning_rate.peak = 1e-2;
  options.adversarial.learning_rate.warmup_steps = 100;
  DecoderObjective objective(test::small_model(), options, random_backbone(), {}, 1);
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImage);
  auto generator = at::detail::createCPUGenerator(2);
  objective.losses(data.batch(0), {64, 1000, generator});
  const auto before = discriminator_weights(objective);
  objective.after_step({64, 1000, generator});
  // The first step of Adam moves a weight by the learning rate: 1e-2 / 100, not 1e-2 * 65 / 100.
  EXPECT_NEAR(largest_difference(before, discriminator_weights(objective)), 1e-4, 2e-6);
}

TEST(DecoderTraining, EveryMicroBatchOfAStepTrainsTheDiscriminator) {
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImage);
  const auto judged = [&](const std::vector<std::pair<int64_t, int64_t>>& steps_and_batches) {
    DecoderObjective objective(test::small_model(), quiet_decoder(), random_backbone(), {}, 1);
    auto generator = at::detail::createCPUGenerator(2);
    for (const auto& [step, batch] : steps_and_batches) {
      objective.losses(data.batch(batch), {step, 10, generator});
    }
    const auto values = objective.after_step({steps_and_batches.back().first, 10, generator});
    return std::make_pair(values.front().second, discriminator_weights(objective));
  };
  const auto both = judged({{3, 0}, {3, 1}}), first = judged({{3, 0}}), second = judged({{3, 1}});
  EXPECT_GT(largest_difference(both.second, second.second), 1e-6);
  // The vectors of the spectral normalisation advance with each pass, so the mean is not exact.
  EXPECT_NEAR(both.first, 0.5 * (first.first + second.first), 0.02);
  // Several workers end in any order; what the discriminator learns is the same.
  const auto other_order = judged({{3, 1}, {3, 0}});
  EXPECT_EQ(other_order.first, both.first);
  EXPECT_EQ(largest_difference(other_order.second, both.second), 0);
  // A step that was skipped because its loss was not finite leaves nothing to the next one.
  const auto after_skipped = judged({{2, 0}, {3, 1}});
  EXPECT_EQ(after_skipped.first, second.first);
  EXPECT_EQ(largest_difference(after_skipped.second, second.second), 0);
}

TEST(DecoderTraining, AnExactPictureHasAnInfinitePsnrThatTheLogHoldsAsNull) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "metrics.jsonl";
  MetricsLog log(file, 0);
  const auto image = torch::rand({1, 3, 8, 8});
  log.append({{"step", 1}, {"validation_psnr", psnr(image, image).mean().item<double>()}});
  log.append({{"step", 2}, {"validation_psnr", 20.0}});
  EXPECT_EQ(log.series("validation_psnr"), (std::vector<std::pair<double, double>>{{2.0, 20.0}}));
  EXPECT_EQ(MetricsLog(file, 2).series("validation_psnr"), log.series("validation_psnr"));
}

// A part that some scenes lack is the mean of those that have it.
TEST(PartMeans, AreOfTheScenesThatHaveThePart) {
  PartMeans parts;
  for (const double value : {1.0, 2.0, 6.0}) parts.add("all", torch::tensor(value));
  parts.add("one", torch::tensor(5.0));
  const auto means = parts.take();
  ASSERT_EQ(means.size(), 2U);
  EXPECT_EQ(means[0].first, "all");
  EXPECT_EQ(means[0].second.item<double>(), 3);
  EXPECT_EQ(means[1].second.item<double>(), 5);
}

TEST(ScenePixels, PatchesAndImagesAreInverse) {
  const auto images = torch::arange(2 * 3 * 28 * 42, torch::kFloat32).view({2, 3, 28, 42});
  const auto patches = image_patches(images, 14);
  EXPECT_EQ(patches.sizes(), (std::vector<int64_t>{2, 6, 588}));
  EXPECT_TRUE(torch::equal(image_of_patches(patches, {2, 2, 3}, 14), images));
  // Second pixel of the second patch, green.
  EXPECT_EQ(patches[0][1][3 + 1].item<float>(), images[0][1][0][15].item<float>());
}

}  // namespace
}  // namespace gld
