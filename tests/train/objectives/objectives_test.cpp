// Two steps of every kind of training with a shrunken configuration, and what each objective promises.
#include "datasets/scenes/frame_checks.h"
#include "gld/metrics/image_metrics.h"
#include "models/bundle/bundle.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/small_training.h"
#include "train/loop/checkpoint.h"
#include "train/loop/metrics_log.h"
#include "train/objectives/backbone_objective.h"
#include "train/objectives/correspondence.h"
#include "train/objectives/decoder_objective.h"
#include "train/objectives/feature_noise.h"
#include "train/objectives/geometry_loss.h"
#include "train/objectives/scene_pixels.h"

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
  expect_metrics(folder.path(), {"depth", "rays", "points", "pixels_level0", "pixels_level1", "depth_abs_rel",
                                 "validation_geometry_loss", "validation_pixel_psnr"});
  const auto bundle = ModelBundle::open(folder.path() / "model");
  EXPECT_TRUE(bundle.has(BundlePart::backbone()));
  EXPECT_TRUE(bundle.has(BundlePart::dpt_head()));
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

TEST(GeometryTargets, RaysTimesDepthAreThePointsInTheFirstCamera) {
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImageAndDepth);
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

// A scene of three cameras in a row before the wall z = 2, turned a little, whose true rays and targets are exact.
TrainingScene wall_scene() {
  TrainingScene scene;
  scene.name = "wall";
  scene.views.num_sources = 2;
  scene.images = torch::zeros({3, 3, 56, 56});
  scene.depth = torch::empty({3, 56, 56});
  for (int view = 0; view < 3; ++view) {
    Camera camera;
    camera.width = camera.height = 56;
    camera.intrinsics = intrinsic_matrix(50, 50, 28, 28);
    camera.world_from_camera.translation() = Eigen::Vector3d(0.1 + 0.28 * view, 0, 0);
    camera.world_from_camera.rotate(Eigen::AngleAxisd(0.05 * view, Eigen::Vector3d::UnitY()));
    for (int64_t row = 0; row < 56; ++row) {
      for (int64_t column = 0; column < 56; ++column) {
        const Eigen::Vector3d ray =
            camera.world_from_camera.linear() * camera.intrinsics.inverse() *
            Eigen::Vector3d(static_cast<double>(column) + 0.5, static_cast<double>(row) + 0.5, 1);
        scene.depth[view][row][column] = 2 / ray.z();
      }
    }
    scene.views.cameras.push_back(camera);
  }
  return scene;
}

TEST(GeometryLoss, OriginsAreMeasuredInBaselines) {
  const GeometryTargets targets = geometry_targets(wall_scene(), {8, 8});
  GeometryOutput predicted;
  predicted.depth = targets.depth;
  predicted.depth_confidence = torch::ones_like(targets.depth);
  predicted.ray_confidence = torch::ones({3, 8, 8});
  GeometryLossOptions options;
  options.ray_weight = options.point_weight = 0;
  // What a head does that does not know the poses: every origin at the first camera. Centres are 1 and 2 steps away, the
  // baseline is 1.5 steps.
  predicted.rays = targets.rays.clone();
  predicted.rays.narrow(3, 3, 3).zero_();
  const auto loss = [&](double unit) {
    GeometryTargets scaled = targets;
    scaled.rays = torch::cat({targets.rays.narrow(3, 0, 3), unit * targets.rays.narrow(3, 3, 3)}, 3);
    return geometry_losses(predicted, scaled, options).origin.item<double>();
  };
  EXPECT_NEAR(loss(1), (1 / 1.5 + 2 / 1.5) / 3, 0.02);
  EXPECT_NEAR(loss(0.01), loss(1), 1e-5);  // the same for small baselines
  EXPECT_EQ(loss(0), 0.0);                 // a camera that only turns has no baseline
  predicted.rays = targets.rays;
  EXPECT_NEAR(loss(1), 0.0, 1e-6);
  options.origin_weight = 3;
  predicted.rays = targets.rays + 0.1;
  const auto weighted = geometry_losses(predicted, targets, options);
  options.origin_weight = 0;
  const auto without = geometry_losses(predicted, targets, options);
  EXPECT_NEAR((weighted.total - without.total).item<double>(), 3 * weighted.origin.item<double>(), 1e-5);
}

TEST(GeometryLoss, RayErrorsAreThoseOfTheCameras) {
  const GeometryTargets targets = geometry_targets(wall_scene(), {8, 8});
  const auto exact = ray_errors(targets.rays, targets);
  EXPECT_NEAR(exact.direction_degrees, 0, 1e-4);
  EXPECT_NEAR(exact.rotation_degrees, 0, 1e-4);
  EXPECT_NEAR(exact.translation_degrees, 0, 1e-4);
  EXPECT_NEAR(exact.origin, 0, 1e-6);
  // The last view turned by 6 degrees about z and its centre moved by one baseline of 1.5 steps across.
  auto rays = targets.rays.clone();
  const auto turn = torch::tensor({std::cos(6 * M_PI / 180), -std::sin(6 * M_PI / 180), 0.0,
                                   std::sin(6 * M_PI / 180), std::cos(6 * M_PI / 180), 0.0, 0.0, 0.0, 1.0})
                        .view({3, 3})
                        .to(torch::kFloat32);
  rays[2].narrow(2, 0, 3).copy_(torch::matmul(targets.rays[2].narrow(2, 0, 3), turn.t()));
  const double step = targets.rays[1][0][0][3].item<double>();
  rays[2].select(2, 4).add_(1.5 * step);
  const auto errors = ray_errors(rays, targets);
  EXPECT_NEAR(errors.rotation_degrees, 6.0 / 2, 1e-3);
  EXPECT_NEAR(errors.origin, 1.0 / 2, 1e-4);
  EXPECT_NEAR(errors.translation_degrees, std::atan2(1.5, 2.0) * 180 / M_PI / 2, 1e-3);
  EXPECT_GT(errors.direction_degrees, 0.1);
}

TEST(GeometryLoss, TokensReadDepthAndTheRayThroughTheirMiddle) {
  const TrainingScene scene = wall_scene();
  const GeometryTargets fine = geometry_targets(scene, {16, 16}), coarse = geometry_targets(scene, {4, 4});
  // Both grids find the scene's size by points of their own.
  const auto rays =
      torch::cat({coarse.rays.narrow(3, 0, 3), coarse.rays.narrow(3, 3, 3) * (coarse.scale / fine.scale)}, 3);
  auto read = torch::empty({3, 16, kTokenGeometry});
  for (int64_t token = 0; token < 16; ++token) {
    for (int64_t part = 0; part < kTokenDepths; ++part) {
      const int64_t row = token / 4 * 4 + part / 4, column = token % 4 * 4 + part % 4;
      read.select(1, token).select(1, part).copy_(fine.ray_depth.select(1, row).select(1, column).log());
    }
    read.select(1, token).narrow(1, kTokenDepths, 6).copy_(rays.select(1, token / 4).select(1, token % 4));
  }
  const torch::NoGradGuard no_grad;
  auto losses = token_geometry_losses(read, fine, {4, 4}, {});
  EXPECT_LT(losses.total.item<double>(), 1e-5);
  EXPECT_LT(losses.depth_abs_rel, 1e-5);
  EXPECT_LT(losses.rays.rotation_degrees, 1e-3);
  read.narrow(2, 0, kTokenDepths).add_(std::log(1.1));
  losses = token_geometry_losses(read, fine, {4, 4}, {});
  EXPECT_NEAR(losses.total.item<double>(), std::log(1.1), 1e-5);
  EXPECT_NEAR(losses.depth_abs_rel, 0.1, 1e-5);
}

TEST(Correspondence, SharesAreWhereTheSurfaceIsSeen) {
  // Without the turns, the wall moves by 50 * 0.28 / 2 = 7 pixels to the left from view to view: half a token.
  TrainingScene scene = wall_scene();
  for (Camera& camera : scene.views.cameras) camera.world_from_camera.linear().setIdentity();
  scene.depth.fill_(2);
  const auto shares = token_correspondence(scene, 14).shares;
  ASSERT_EQ(shares.sizes(), (std::vector<int64_t>{3, 16, 3, 16}));
  const auto share = [&](int64_t from, int64_t token, int64_t to, int64_t other) {
    return shares[from][token][to][other].item<double>();
  };
  EXPECT_EQ(share(0, 5, 1, 5), 0.5);
  EXPECT_EQ(share(0, 5, 1, 4), 0.5);
  EXPECT_EQ(share(0, 4, 1, 4), 0.5);  // its left half has left the picture
  EXPECT_EQ(shares[0][4][1].sum().item<double>(), 0.5);
  EXPECT_EQ(share(0, 5, 2, 4), 1.0);
  EXPECT_EQ(share(2, 4, 0, 5), 1.0);
  EXPECT_EQ(shares[1].select(1, 1).sum().item<double>(), 0.0);  // nothing within a view
  // A thing in front of the wall in view 1 hides it there.
  scene.depth[1].narrow(0, 14, 14).fill_(1);
  EXPECT_EQ(token_correspondence(scene, 14).shares[0][5][1].sum().item<double>(), 0.0);
}

TEST(Correspondence, TheLossIsLeastWhereAttentionLooksAtTheRightPlace) {
  TrainingScene scene = wall_scene();
  for (Camera& camera : scene.views.cameras) camera.world_from_camera.linear().setIdentity();
  scene.depth.fill_(2);
  const auto truth = token_correspondence(scene, 14);
  const int64_t tokens = 3 * 17;  // one special token a view in front
  AttentionTap tap;
  tap.query = torch::zeros({1, tokens, 2, 8}).requires_grad_(true);
  tap.key = torch::ones({1, tokens, 2, 8});
  // All keys alike: targets choose among 2 x 16 source tokens, sources among the 16 of the other source.
  const auto uniform = correspondence_loss(tap, truth, {1, 2});
  int64_t from_sources = 0, from_targets = 0;
  for (int64_t view = 0; view < 3; ++view) {
    const auto seen = truth.shares[view].narrow(1, 0, 2).sum(std::vector<int64_t>{1, 2}) > 0;
    (view < 2 ? from_sources : from_targets) += seen.sum().item<int64_t>();
  }
  const double expected = (static_cast<double>(from_sources) * std::log(16.0) +
                           static_cast<double>(from_targets) * std::log(32.0)) /
                          static_cast<double>(from_sources + from_targets);
  EXPECT_NEAR(uniform.item<double>(), expected, 1e-5);
  uniform.backward();
  EXPECT_TRUE(torch::isfinite(tap.query.grad()).all().item<bool>());
  // Keys that stand for their place on the wall, and queries that ask for theirs.
  const auto place = [&](double sharpness) {
    auto features = torch::zeros({1, tokens, 2, 8});
    for (int64_t view = 0; view < 3; ++view) {
      for (int64_t token = 0; token < 16; ++token) {
        const double x = static_cast<double>(token % 4) + 0.5 * static_cast<double>(view);
        const double y = static_cast<double>(token / 4);
        for (int64_t head = 0; head < 2; ++head) {
          auto feature = features[0][view * 17 + 1 + token][head];
          feature[0] = sharpness * std::cos(x);
          feature[1] = sharpness * std::sin(x);
          feature[2] = sharpness * std::cos(y);
          feature[3] = sharpness * std::sin(y);
        }
      }
    }
    return features;
  };
  tap.query = tap.key = place(2);
  const double right = correspondence_loss(tap, truth, {1, 2}).item<double>();
  EXPECT_LT(right, 0.8 * expected);
  tap.query = -tap.key;
  EXPECT_GT(correspondence_loss(tap, truth, {1, 2}).item<double>(), expected);
  // Nothing is seen twice where a single view is the key of itself alone.
  TrainingScene one = scene;
  one.views.cameras.resize(1);
  one.depth = scene.depth.narrow(0, 0, 1);
  one.images = scene.images.narrow(0, 0, 1);
  tap.query = tap.key = torch::ones({1, 17, 2, 8});
  EXPECT_FALSE(correspondence_loss(tap, token_correspondence(one, 14), {1, 1}).defined());
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
  options.correspondence_blocks = {4};
  EXPECT_EQ(
      test::error_of([&] { BackboneObjective(test::small_model(), options, {}, 1); }),
      "objective.correspondence_blocks: expected blocks below 8 that attend over all views, found 4; choose "
      "others.");
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
  expect_metrics(folder.path(), {"reconstruction", "perceptual", "adversarial", "adaptive_weight",
                                 "discriminator", "discriminator_accuracy", "validation_psnr"});
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

// What moves the discriminator's weights, without the vectors of its spectral normalisation.
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
