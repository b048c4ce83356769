#include "train/objectives/geometry_loss.h"

#include "gld/cameras/pose_encoding.h"
#include "tests/train/small_training.h"
#include "tests/train/wall_scene.h"

#include <cmath>

#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::wall_scene;

TEST(GeometryTargets, RaysTimesDepthAreThePointsInTheFirstCamera) {
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImageAndDepth);
  const TrainingScene scene = data.batch(3).scenes.front();
  const GeometryTargets targets = *geometry_targets(scene, {14, 14});
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

TEST(GeometryTargets, CamerasAreThoseOfTheRays) {
  const DatasetBatches data(test::small_data(), {{56, 56}}, FrameParts::kImageAndDepth);
  const TrainingScene scene = data.batch(3).scenes.front();
  const GeometryTargets targets = *geometry_targets(scene, {14, 14});
  ASSERT_EQ(targets.cameras.sizes(), torch::IntArrayRef({3, 9}));
  for (int64_t view = 0; view < 3; ++view) {
    PoseEncoding encoding{};
    for (int64_t i = 0; i < 9; ++i)
      encoding[static_cast<size_t>(i)] = targets.cameras[view][i].item<double>();
    const Camera camera = camera_of_pose_encoding(encoding, {56, 56});
    const Eigen::Matrix3d back = camera.world_from_camera.linear() * camera.intrinsics.inverse();
    // The cell of the first test.
    const Eigen::Vector3d direction = back * Eigen::Vector3d(22.0, 10.0, 1.0);
    for (int axis = 0; axis < 3; ++axis) {
      EXPECT_NEAR(targets.rays[view][2][5][axis].item<double>(), direction[axis], 1e-5);
      EXPECT_NEAR(targets.rays[view][2][5][axis + 3].item<double>(),
                  camera.world_from_camera.translation()[axis], 1e-6);
    }
  }
}

TEST(GeometryLoss, DecodedCamerasHaveAnErrorOfTheirOwn) {
  GeometryTargets targets;
  targets.depth = torch::ones({1, 2, 2});
  targets.valid = torch::ones({1, 2, 2}, torch::kBool);
  targets.rays = torch::zeros({1, 1, 1, 6});
  targets.ray_depth = torch::ones({1, 1, 1});
  targets.ray_valid = torch::ones({1, 1, 1}, torch::kBool);
  targets.cameras = torch::zeros({1, 9});
  GeometryOutput predicted;
  predicted.depth = torch::ones({1, 2, 2});
  predicted.depth_confidence = torch::ones({1, 2, 2});
  predicted.rays = torch::zeros({1, 1, 1, 6});
  predicted.ray_confidence = torch::ones({1, 1, 1});
  GeometryLossOptions options;
  const auto without = geometry_losses(predicted, targets, options);
  EXPECT_FALSE(without.camera.defined());
  predicted.camera_encodings = torch::zeros({1, 9});
  predicted.camera_encodings[0][3] = -0.9F;
  options.camera_weight = 5;
  const auto with = geometry_losses(predicted, targets, options);
  EXPECT_NEAR(with.camera.item<double>(), 0.1, 1e-7);
  EXPECT_NEAR((with.total - without.total).item<double>(), 0.5, 1e-6);
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

TEST(GeometryLoss, OriginsAreMeasuredInBaselines) {
  const GeometryTargets targets = *geometry_targets(wall_scene(), {8, 8});
  GeometryOutput predicted;
  predicted.depth = targets.depth;
  predicted.depth_confidence = torch::ones_like(targets.depth);
  predicted.ray_confidence = torch::ones({3, 8, 8});
  GeometryLossOptions options;
  options.ray_weight = options.point_weight = 0;
  // What a head does that does not know the poses: every origin at the first camera. Centres are 1 and 2 steps away,
  // the baseline is 1.5 steps.
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
  const GeometryTargets targets = *geometry_targets(wall_scene(), {8, 8});
  const auto exact = ray_errors(targets.rays, targets);
  EXPECT_NEAR(exact.direction_degrees, 0, 1e-4);
  EXPECT_NEAR(exact.rotation_degrees, 0, 1e-4);
  EXPECT_NEAR(exact.translation_degrees, 0, 1e-4);
  EXPECT_NEAR(exact.origin, 0, 1e-6);
  // The last view is turned by 6 degrees about z and its centre moved by one baseline of 1.5 steps across.
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
  const GeometryTargets fine = *geometry_targets(scene, {16, 16}), coarse = *geometry_targets(scene, {4, 4});
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

// A head that predicts points apart from depth learns them from where depth and rays are.
TEST(GeometryLoss, PredictedPointsAreComparedWithTheTrueOnes) {
  const GeometryTargets targets = *geometry_targets(wall_scene(), {56, 56});
  GeometryOutput predicted;
  predicted.depth = targets.depth;
  predicted.depth_confidence = torch::ones_like(targets.depth);
  predicted.rays = targets.rays;
  predicted.ray_confidence = torch::ones({3, 56, 56});
  GeometryLossOptions options;
  const auto without = geometry_losses(predicted, targets, options);
  EXPECT_FALSE(without.point_map.defined());
  const auto exact =
      targets.rays.narrow(3, 0, 3) * targets.ray_depth.unsqueeze(3) + targets.rays.narrow(3, 3, 3);
  predicted.points = exact.clone().requires_grad_(true);
  predicted.point_confidence = torch::ones({3, 56, 56});
  EXPECT_NEAR(geometry_losses(predicted, targets, options).point_map.item<double>(), 0, 1e-6);
  predicted.points = (exact + 0.25).requires_grad_(true);
  options.point_weight = 2;
  auto losses = geometry_losses(predicted, targets, options);
  EXPECT_NEAR(losses.point_map.item<double>(), 0.25, 1e-5);
  losses.total.backward();
  EXPECT_GT(predicted.points.grad().abs().sum().item<double>(), 0);
  // The surer a point is, the dearer it is, with the reward of depth's confidence.
  predicted.point_confidence = torch::full({3, 56, 56}, 3.0);
  losses = geometry_losses(predicted, targets, options);
  EXPECT_NEAR(losses.point_map.item<double>(), 3 * 0.25 - options.confidence_reward * std::log(3.0), 1e-5);
}

}  // namespace
}  // namespace gld
