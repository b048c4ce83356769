#include "gld/metrics/pose_metrics.h"

#include "gld/base/error.h"
#include "gld/metrics/metric_list.h"
#include "gld/photogrammetry/pose_from_rays.h"
#include "tests/support/error_of.h"
#include "tests/support/random_cameras.h"

#include <cmath>
#include <limits>

#include <Eigen/Geometry>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

constexpr double kRadians = 3.14159265358979323846 / 180;
constexpr int64_t kColumns = 12, kRows = 9;

// Returns two sources and two targets, with centred principal points.
Views scene_views() {
  test::RandomCameras random(3);
  Views views;
  views.num_sources = 2;
  for (int i = 0; i < 4; ++i) {
    Camera camera = random.ordinary(120, 90);
    camera.intrinsics(0, 2) = 60;
    camera.intrinsics(1, 2) = 45;
    views.cameras.push_back(camera);
  }
  return views;
}

torch::Tensor rays_of(const std::vector<Camera>& cameras) {
  std::vector<torch::Tensor> rays;
  for (const Camera& camera : cameras) {
    RayMap map = rays_of_camera(camera, kColumns, kRows);
    rays.push_back(torch::from_blob(map.values.data(), {kRows, kColumns, 6}).clone());
  }
  return torch::stack(rays);
}

// In another frame and another unit.
std::vector<Camera> moved(const std::vector<Camera>& cameras, const Eigen::Isometry3d& by, double unit) {
  std::vector<Camera> result = cameras;
  for (Camera& camera : result) {
    camera.world_from_camera = by * camera.world_from_camera;
    camera.world_from_camera.translation() *= unit;
  }
  return result;
}

Eigen::Isometry3d some_motion() {
  Eigen::Isometry3d motion = Eigen::Isometry3d::Identity();
  motion.linear() = Eigen::AngleAxisd(1.1, Eigen::Vector3d(1, -2, 0.5).normalized()).toRotationMatrix();
  motion.translation() = Eigen::Vector3d(3, -1, 2);
  return motion;
}

void expect_all(const torch::Tensor& errors, double value, double tolerance) {
  EXPECT_EQ(errors.size(0), 2);
  EXPECT_LT((errors - value).abs().max().item<double>(), tolerance) << errors;
}

TEST(PoseErrors, AreZeroForTheScenesOwnRaysInAnyFrameAndUnit) {
  const Views views = scene_views();
  for (const double unit : {1.0, 0.01}) {
    const auto predicted = moved(views.cameras, some_motion(), unit);
    const auto errors = pose_errors(views, predicted, rays_of(predicted));
    expect_all(errors.rotation, 0, 1e-6);
    expect_all(errors.translation_direction, 0, 1e-6);
    expect_all(errors.ray_angle, 0, 1e-4);
    expect_all(errors.ray_origin, 0, 1e-5);
  }
}

// This goes from the rays to the errors, as gld eval goes.
TEST(PoseErrors, OfCamerasThatWereFittedToExactRaysAreZero) {
  const Views views = scene_views();
  const auto exact = moved(views.cameras, some_motion(), 0.3);
  std::vector<Camera> fitted;
  fitted.reserve(exact.size());
  for (const Camera& camera : exact) {
    fitted.push_back(camera_from_rays(rays_of_camera(camera, kColumns, kRows), ConfidenceMap(),
                                      {camera.width, camera.height},
                                      KnownIntrinsics{camera.intrinsics.block<2, 1>(0, 2), {}})
                         .camera);
  }
  MetricInputs inputs;
  inputs.views = views;
  inputs.predicted_cameras = fitted;
  inputs.rays = rays_of(exact);
  for (const char* name : {"rotation_error", "translation_direction_error", "ray_angle_error"}) {
    EXPECT_LT(measure(metric_named(name), inputs).mean(), 1e-3) << name;
  }
  EXPECT_LT(measure(metric_named("ray_origin_error"), inputs).mean(), 1e-4);
}

TEST(PoseErrors, OfTurnedRaysAreTheTurn) {
  const Views views = scene_views();
  // Target 0 is turned by 7 degrees about its own optical axis, target 1 by 20 about its vertical.
  auto predicted = views.cameras;
  predicted[2].world_from_camera.rotate(Eigen::AngleAxisd(7 * kRadians, Eigen::Vector3d::UnitZ()));
  predicted[3].world_from_camera.rotate(Eigen::AngleAxisd(20 * kRadians, Eigen::Vector3d::UnitY()));
  const auto errors = pose_errors(views, predicted, rays_of(predicted));
  EXPECT_NEAR(errors.rotation[0].item<double>(), 7, 1e-6);
  EXPECT_NEAR(errors.rotation[1].item<double>(), 20, 1e-6);
  expect_all(errors.translation_direction, 0, 1e-6);
  expect_all(errors.ray_origin, 0, 1e-5);
  // A direction at height h from the axis' equator moves by acos(1 - (1 - cos 20)(1 - h^2)); the centre row's by 20.
  double angle = 0;
  for (int64_t y = 0; y < kRows; ++y) {
    for (int64_t x = 0; x < kColumns; ++x) {
      const Eigen::Vector3d pixel((static_cast<double>(x) + 0.5) * 10, (static_cast<double>(y) + 0.5) * 10,
                                  1);
      const double h = (views.cameras[3].intrinsics.inverse() * pixel).normalized().y();
      angle += std::acos(1 - (1 - std::cos(20 * kRadians)) * (1 - h * h)) / kRadians / (kRows * kColumns);
    }
  }
  EXPECT_LT(angle, 20);
  EXPECT_NEAR(errors.ray_angle[1].item<double>(), angle, 1e-3);
  EXPECT_LT(errors.ray_angle[0].item<double>(), 7);
  EXPECT_GT(errors.ray_angle[0].item<double>(), 0.5);
}

TEST(PoseErrors, OfTheFirstViewGoIntoEveryTarget) {
  const Views views = scene_views();
  auto predicted = views.cameras;
  predicted[0].world_from_camera.rotate(Eigen::AngleAxisd(5 * kRadians, Eigen::Vector3d::UnitX()));
  expect_all(pose_errors(views, predicted, rays_of(predicted)).rotation, 5, 1e-6);
}

TEST(PoseErrors, OriginsAndDirectionsOfTranslationFollowTheCentres) {
  Views views = scene_views();
  for (size_t i = 0; i < 4; ++i) {
    views.cameras[i].world_from_camera = Eigen::Isometry3d::Identity();
    views.cameras[i].world_from_camera.translation().x() = static_cast<double>(i);
  }
  // All origins are at one place: no scale explains the centres, and each is as far off as it stands from the first.
  auto predicted = views.cameras;
  for (Camera& camera : predicted) camera.world_from_camera.translation().setZero();
  auto errors = pose_errors(views, predicted, rays_of(predicted));
  EXPECT_NEAR(errors.ray_origin[0].item<double>(), 2.0 / 3, 1e-6);
  EXPECT_NEAR(errors.ray_origin[1].item<double>(), 1, 1e-6);
  EXPECT_TRUE(errors.translation_direction.isnan().all().item<bool>());
  // One target goes up instead of sideways: 90 degrees, and the other none.
  predicted = views.cameras;
  predicted[3].world_from_camera.translation() = Eigen::Vector3d(0, 3, 0);
  errors = pose_errors(views, predicted, rays_of(predicted));
  EXPECT_NEAR(errors.translation_direction[0].item<double>(), 0, 1e-6);
  EXPECT_NEAR(errors.translation_direction[1].item<double>(), 90, 1e-6);
  // Scale (1 + 4) / (1 + 4 + 9) fits best.
  const double scale = 5.0 / 14;
  EXPECT_NEAR(errors.ray_origin[0].item<double>(), 2 * (1 - scale) / 3, 1e-6);
  EXPECT_NEAR(errors.ray_origin[1].item<double>(), std::hypot(3, 3 * scale) / 3, 1e-6);
}

TEST(PoseMetrics, WithoutABaselineDirectionAndOriginAreAbsent) {
  MetricInputs inputs;
  inputs.views = scene_views();
  for (Camera& camera : inputs.views.cameras) camera.world_from_camera.translation().setZero();
  inputs.predicted_cameras = inputs.views.cameras;
  inputs.rays = rays_of(inputs.views.cameras);
  EXPECT_EQ(measure(metric_named("translation_direction_error"), inputs).absent,
            "the cameras, true or predicted, stand at one place");
  EXPECT_EQ(measure(metric_named("ray_origin_error"), inputs).absent,
            "the scene's cameras stand at one place");
  EXPECT_NEAR(measure(metric_named("rotation_error"), inputs).mean(), 0, 1e-9);
}

TEST(PoseErrors, LeaveOutRaysThatAreNotFiniteAndRefuseMissingViews) {
  const Views views = scene_views();
  auto rays = rays_of(views.cameras);
  rays[2][0][0][1] = std::numeric_limits<float>::quiet_NaN();
  rays[3].fill_(std::numeric_limits<float>::infinity());
  const auto errors = pose_errors(views, views.cameras, rays);
  EXPECT_NEAR(errors.ray_angle[0].item<double>(), 0, 1e-4);
  EXPECT_TRUE(std::isnan(errors.ray_angle[1].item<double>()));
  EXPECT_THAT(test::error_of([&] { pose_errors(views, views.cameras, rays.narrow(0, 0, 3)); }),
              testing::HasSubstr("found 4 cameras and rays of shape [3, 9, 12, 6]"));
}

// Frame and unit do not count; what is left does.
TEST(PoseMetrics, EstimatedCamerasAreComparedAsTheirFirstOneSeesThem) {
  std::vector<Camera> truth(3), estimated(3);
  truth[1].world_from_camera.translation() = Eigen::Vector3d(1, 0, 0);
  truth[2].world_from_camera.translation() = Eigen::Vector3d(0, 2, 0);
  Eigen::Isometry3d frame = Eigen::Isometry3d::Identity();
  frame.linear() = Eigen::AngleAxisd(1, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  frame.translation() = Eigen::Vector3d(5, 6, 7);
  for (size_t i = 0; i < 3; ++i) {
    estimated[i].world_from_camera = frame * truth[i].world_from_camera;
    estimated[i].world_from_camera.translation() =
        frame * Eigen::Vector3d(0.1 * truth[i].world_from_camera.translation());
  }
  auto errors = estimated_camera_errors(truth, estimated);
  EXPECT_LT(errors.rotation.max().item<double>(), 1e-6);
  EXPECT_LT(errors.translation_direction.max().item<double>(), 1e-6);
  EXPECT_LT(errors.centre.max().item<double>(), 1e-9);
  const Eigen::Matrix3d off = Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitX()).toRotationMatrix();
  estimated[2].world_from_camera.linear() = (estimated[2].world_from_camera.linear() * off).eval();
  errors = estimated_camera_errors(truth, estimated);
  EXPECT_LT(errors.rotation[0].item<double>(), 1e-6);
  EXPECT_NEAR(errors.rotation[1].item<double>(), 5.7296, 1e-3);
  // All are at one place: that is as far off as the truth is long.
  for (Camera& camera : estimated) camera.world_from_camera.translation().setZero();
  errors = estimated_camera_errors(truth, estimated);
  EXPECT_TRUE(errors.translation_direction.isnan().all().item<bool>());
  EXPECT_NEAR(errors.centre[1].item<double>(), 2 / std::sqrt(5.0), 1e-9);
  estimated.pop_back();
  EXPECT_THROW(estimated_camera_errors(truth, estimated), Error);
}

}  // namespace
}  // namespace gld
