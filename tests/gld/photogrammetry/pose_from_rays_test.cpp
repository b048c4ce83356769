#include "gld/photogrammetry/pose_from_rays.h"

#include "gld/cameras/pose_alignment.h"
#include "tests/support/error_of.h"
#include "tests/support/worst_of.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include <Eigen/Geometry>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using Eigen::Vector3d;

Camera tilted(double turn) {
  Camera camera;
  camera.width = 504;
  camera.height = 280;
  camera.intrinsics << 420, 0, 262, 0, 405, 131, 0, 0, 1;
  camera.world_from_camera.linear() =
      (Eigen::AngleAxisd(turn, Vector3d(1, 2, -0.5).normalized())).toRotationMatrix();
  camera.world_from_camera.translation() = Vector3d(0.7, -0.3, 2 + turn);
  return camera;
}

struct CameraErrors {
  double rotation = 0;  // degrees
  double centre = 0;
  double focal = 0;      // relative
  double principal = 0;  // pixels
};

CameraErrors camera_errors_of(const Camera& found, const Camera& truth) {
  CameraErrors errors;
  errors.rotation = rotation_angle(found.world_from_camera.linear(), truth.world_from_camera.linear());
  errors.centre = (found.world_from_camera.translation() - truth.world_from_camera.translation()).norm();
  for (int i = 0; i < 2; ++i) {
    errors.focal =
        test::worst_of(errors.focal, std::abs(found.intrinsics(i, i) / truth.intrinsics(i, i) - 1));
    errors.principal =
        test::worst_of(errors.principal, std::abs(found.intrinsics(i, 2) - truth.intrinsics(i, 2)));
  }
  return errors;
}

// Turns every direction by a normal angle of that many degrees on each axis, and shifts every origin.
void disturb(RayMap& rays, double degrees, double shift, uint64_t seed) {
  std::mt19937_64 generator(seed);
  std::normal_distribution<double> normal;
  // In braces one is drawn after the other; the order of a call's arguments is the compiler's own.
  const auto random = [&] { return Vector3d{normal(generator), normal(generator), normal(generator)}; };
  for (int64_t y = 0; y < rays.height; ++y) {
    for (int64_t x = 0; x < rays.width; ++x) {
      float* ray = rays.ray(x, y);
      const Vector3d direction(ray[0], ray[1], ray[2]);
      const Vector3d noise = random() * degrees * std::acos(-1.0) / 180 * direction.norm();
      const Vector3d origin_noise = random() * shift;
      for (int i = 0; i < 3; ++i) {
        ray[i] += static_cast<float>(noise[i]);
        ray[3 + i] += static_cast<float>(origin_noise[i]);
      }
    }
  }
}

TEST(CameraFromRays, RecoversTheCameraOfExactRays) {
  for (const double turn : {0.0, 0.8, 2.9}) {
    const Camera truth = tilted(turn);
    const RecoveredCamera found = camera_from_rays(rays_of_camera(truth, 36, 20), {}, {504, 280});
    const CameraErrors errors = camera_errors_of(found.camera, truth);
    EXPECT_LT(errors.rotation, 1e-5);
    EXPECT_LT(errors.centre, 1e-6);
    EXPECT_LT(errors.focal, 1e-6);
    EXPECT_LT(errors.principal, 1e-4);
    EXPECT_LT(found.direction_error, 1e-5);
    EXPECT_LT(found.origin_error, 1e-6);
    EXPECT_EQ(found.camera.width, 504);
    EXPECT_EQ(found.camera.height, 280);
  }
}

TEST(CameraFromRays, DoesNotDependOnTheLengthsOfTheDirections) {
  const Camera truth = tilted(0.4);
  RayMap rays = rays_of_camera(truth, 24, 16);
  for (int64_t i = 0; i < 24 * 16; ++i) {
    const float factor = std::ldexp(1.0F, static_cast<int>(i % 11) - 5);
    for (int k = 0; k < 3; ++k) rays.values[static_cast<size_t>(6 * i + k)] *= factor;
  }
  const CameraErrors errors = camera_errors_of(camera_from_rays(rays, {}, {504, 280}).camera, truth);
  EXPECT_LT(errors.rotation, 1e-5);
  EXPECT_LT(errors.focal, 1e-6);
}

TEST(CameraFromRays, AveragesNoise) {
  const Camera truth = tilted(0.8);
  RayMap rays = rays_of_camera(truth, 72, 40);
  disturb(rays, 1.0, 0.05, 3);
  const RecoveredCamera found = camera_from_rays(rays, {}, {504, 280});
  const CameraErrors errors = camera_errors_of(found.camera, truth);
  // A turn e about the horizontal axis moves the ray at height y by e (1 + y^2), a shift of the principal point all
  // alike: only y^2, whose deviation over the picture (|y| < .35) is .036, tells them apart. With 2880 rays of 1 degree
  // the turn has a deviation of 1 / (sqrt(2880) .036) = .5 degrees, the principal point one of 405 tan(.5 degrees) =
  // 3.6 pixels; 3 of each are allowed.
  EXPECT_LT(errors.rotation, 1.6);
  EXPECT_LT(errors.principal, 11);
  EXPECT_LT(errors.centre, 0.005);
  EXPECT_LT(errors.focal, 0.01);
  EXPECT_NEAR(found.direction_error, 1.18, 0.1);  // median of a two-dimensional normal of 1 degree
  EXPECT_GT(found.inliers, 0.95);
}

TEST(CameraFromRays, ResistsOutliersAndListensToConfidence) {
  const Camera truth = tilted(0.8);
  RayMap rays = rays_of_camera(truth, 48, 30);
  disturb(rays, 0.2, 0.01, 5);
  std::mt19937_64 generator(9);
  std::normal_distribution<float> normal;
  for (int64_t i = 0; i < 48 * 30; i += 5) {  // every fifth ray is nonsense
    for (int k = 0; k < 6; ++k) rays.values[static_cast<size_t>(6 * i + k)] = 3 * normal(generator);
  }
  const RecoveredCamera found = camera_from_rays(rays, {}, {504, 280});
  const CameraErrors errors = camera_errors_of(found.camera, truth);
  EXPECT_LT(errors.rotation, 0.2);
  EXPECT_LT(errors.centre, 0.005);
  EXPECT_LT(errors.focal, 0.005);
  EXPECT_NEAR(found.inliers, 0.8, 0.03);

  // A consistent second camera in more than half of the picture, which only the confidence tells apart.
  const RayMap other = rays_of_camera(tilted(1.1), 48, 30);
  ConfidenceMap confidence(48, 30);
  RayMap mixed = rays_of_camera(truth, 48, 30);
  for (int64_t y = 0; y < 30; ++y) {
    for (int64_t x = 0; x < 48; ++x) {
      const bool wrong = x >= 20;
      confidence.at(x, y) = wrong ? 0.0F : 1.5F;
      if (wrong) std::copy(other.ray(x, y), other.ray(x, y) + 6, mixed.ray(x, y));
    }
  }
  EXPECT_LT(camera_errors_of(camera_from_rays(mixed, confidence, {504, 280}).camera, truth).rotation, 1e-4);
}

TEST(CameraFromRays, KeepsTheFocalLengthsThatAreGiven) {
  const Camera truth = tilted(0.8);
  const Eigen::Vector2d principal_point = truth.intrinsics.block<2, 1>(0, 2);
  const Eigen::Vector2d focal_lengths(truth.intrinsics(0, 0), truth.intrinsics(1, 1));
  const KnownIntrinsics known{principal_point, focal_lengths};
  const KnownIntrinsics free{principal_point, std::nullopt};
  double free_error = 0;
  double kept_error = 0;
  for (const uint64_t seed : {1, 2, 3, 4, 5, 6}) {
    RayMap rays = rays_of_camera(truth, 36, 20);
    disturb(rays, 1.0, 0, seed);
    const Camera kept = camera_from_rays(rays, {}, {504, 280}, known).camera;
    EXPECT_LT((kept.intrinsics - truth.intrinsics).norm(), 1e-9);
    kept_error += camera_errors_of(kept, truth).rotation / 6;
    free_error += camera_errors_of(camera_from_rays(rays, {}, {504, 280}, free).camera, truth).rotation / 6;
  }
  EXPECT_LE(kept_error, 1.02 * free_error);
  // Wrong ones are kept as well: the camera turns as well as it can.
  const KnownIntrinsics longer{principal_point, Eigen::Vector2d(1.2 * focal_lengths)};
  const RecoveredCamera wrong = camera_from_rays(rays_of_camera(truth, 36, 20), {}, {504, 280}, longer);
  EXPECT_NEAR(wrong.camera.intrinsics(0, 0), 1.2 * truth.intrinsics(0, 0), 1e-9);
  EXPECT_LT(camera_errors_of(wrong.camera, truth).rotation, 0.5);
  EXPECT_GT(wrong.direction_error, 1);
}

TEST(CameraFromRays, KeepsThePrincipalPointThatIsGiven) {
  for (const Eigen::Vector2d& principal : {Eigen::Vector2d(252, 140), Eigen::Vector2d(310, 84)}) {
    Camera truth = tilted(0.8);
    truth.intrinsics.block<2, 1>(0, 2) = principal;
    double free_error = 0;
    double kept_error = 0;
    for (const uint64_t seed : {1, 2, 3, 4, 5, 6}) {
      RayMap rays = rays_of_camera(truth, 36, 20);
      disturb(rays, 1.0, 0, seed);
      const Camera free = camera_from_rays(rays, {}, {504, 280}).camera;
      const Camera kept = camera_from_rays(rays, {}, {504, 280}, KnownIntrinsics{principal, {}}).camera;
      EXPECT_NEAR(kept.intrinsics(0, 2), principal.x(), 1e-9);
      EXPECT_NEAR(kept.intrinsics(1, 2), principal.y(), 1e-9);
      EXPECT_LT(camera_errors_of(kept, truth).focal, 0.02);
      free_error += camera_errors_of(free, truth).rotation / 6;
      kept_error += camera_errors_of(kept, truth).rotation / 6;
    }
    EXPECT_LT(kept_error, 0.25);
    EXPECT_LT(kept_error, 0.8 * free_error);
  }
}

TEST(CameraFromRays, WorksForNarrowAndWideLensesAndLongShapes) {
  for (const double focal : {60.0, 252.0, 5000.0}) {  // 153, 90 and 5.8 degrees across
    Camera truth = tilted(1.2);
    truth.intrinsics(0, 0) = truth.intrinsics(1, 1) = focal;
    const CameraErrors errors =
        camera_errors_of(camera_from_rays(rays_of_camera(truth, 36, 20), {}, {504, 280}).camera, truth);
    EXPECT_LT(errors.rotation, 1e-3) << focal;
    EXPECT_LT(errors.focal, 1e-3) << focal;
  }
  Camera tall = tilted(0.3);
  tall.width = 63;
  tall.height = 504;
  tall.intrinsics << 300, 0, 31, 0, 300, 250, 0, 0, 1;
  const CameraErrors errors =
      camera_errors_of(camera_from_rays(rays_of_camera(tall, 4, 32), {}, {63, 504}).camera, tall);
  EXPECT_LT(errors.rotation, 1e-3);
  EXPECT_LT(errors.focal, 1e-4);
}

TEST(CameraFromRays, RefusesWhatIsNoCamera) {
  const Camera truth = tilted(0.8);
  const RayMap rays = rays_of_camera(truth, 12, 8);
  ConfidenceMap none(12, 8);
  EXPECT_EQ(test::error_of([&] {
              camera_from_rays(rays, none, {504, 280});
            }),
            "camera from rays: expected at least 16 finite rays with a positive confidence, found 0; "
            "check the ray map.");
  EXPECT_EQ(
      test::error_of([&] {
        camera_from_rays(rays, ConfidenceMap(8, 12), {504, 280});
      }),
      "camera from rays: expected confidences of the rays' size 12x8, found 8x12; check what made them.");
  RayMap broken = rays;
  std::fill(broken.values.begin(), broken.values.end(), std::numeric_limits<float>::quiet_NaN());
  EXPECT_EQ(test::error_of([&] {
              camera_from_rays(broken, {}, {504, 280});
            }),
            "camera from rays: expected at least 16 finite rays with a positive confidence, found 0; "
            "check the ray map.");
  RayMap parallel = rays;
  for (int64_t i = 0; i < 12 * 8; ++i)
    std::copy(rays.ray(0, 0), rays.ray(0, 0) + 6, parallel.values.begin() + 6 * i);
  EXPECT_EQ(test::error_of([&] {
              camera_from_rays(parallel, {}, {504, 280});
            }),
            "camera from rays: expected rays that spread over the picture, found rays that fit many cameras; "
            "check the ray map.");
  RayMap mirrored = rays;
  for (int64_t i = 0; i < 12 * 8; ++i) mirrored.values[static_cast<size_t>(6 * i)] *= -1;
  EXPECT_EQ(test::error_of([&] {
              camera_from_rays(mirrored, {}, {504, 280});
            }),
            "camera from rays: expected rays of a camera, found mirrored rays; check the axis convention.");
}

std::vector<Camera> moved(const std::vector<Camera>& cameras, const Similarity& similarity) {
  std::vector<Camera> result = cameras;
  for (Camera& camera : result) {
    const Vector3d centre = similarity * camera.world_from_camera.translation();
    camera.world_from_camera.linear() = similarity.rotation * camera.world_from_camera.linear();
    camera.world_from_camera.translation() = centre;
  }
  return result;
}

TEST(PoseAlignment, FindsTheSimilarityAlsoForCentresOnALine) {
  std::vector<Camera> line;
  for (int i = 0; i < 4; ++i) {
    Camera camera = tilted(0.1 * i);
    camera.world_from_camera.translation() = Vector3d(0.5 * i, 0.25 * i, -1.0 * i);
    line.push_back(camera);
  }
  Similarity truth;
  truth.scale = 0.03;
  truth.rotation = Eigen::AngleAxisd(2, Vector3d(1, -1, 2).normalized()).toRotationMatrix();
  truth.translation = Vector3d(100, -20, 3);
  const PoseAlignment found = align_poses(line, moved(line, truth));
  EXPECT_TRUE(found.scale_known);
  EXPECT_NEAR(found.b_from_a.scale, 0.03, 1e-12);
  EXPECT_LT((found.b_from_a.rotation - truth.rotation).norm(), 1e-12);
  EXPECT_LT((found.b_from_a.translation - truth.translation).norm(), 1e-11);
  EXPECT_LT(found.centre_error, 1e-11);
  EXPECT_LT(found.rotation_error, 1e-5);
}

TEST(PoseAlignment, SaysWhenThereIsNoScale) {
  std::vector<Camera> rotating{tilted(0), tilted(0.3)};
  for (Camera& camera : rotating) camera.world_from_camera.translation() = Vector3d(1, 2, 3);
  const PoseAlignment found = align_poses(rotating, rotating);
  EXPECT_FALSE(found.scale_known);
  EXPECT_EQ(found.b_from_a.scale, 1);
  EXPECT_LT(found.centre_error, 1e-12);
  EXPECT_FALSE(align_poses({tilted(0.5)}, {tilted(0.2)}).scale_known);
  // Centres that contradict each other.
  std::vector<Camera> forward{tilted(0), tilted(0)};
  forward[1].world_from_camera.translation() += Vector3d(0, 0, 1);
  std::vector<Camera> backward{tilted(0), tilted(0)};
  backward[1].world_from_camera.translation() -= Vector3d(0, 0, 1);
  EXPECT_FALSE(align_poses(forward, backward).scale_known);
  EXPECT_EQ(test::error_of([&] { align_poses(forward, {tilted(0)}); }),
            "pose alignment: expected the same cameras twice, found 2 and 1 cameras; check the views.");
}

}  // namespace
}  // namespace gld
