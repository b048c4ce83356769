#include "gld/metrics/reprojection_metrics.h"

#include "gld/metrics/metric_list.h"
#include "tests/support/error_of.h"
#include "tests/support/plane_room.h"
#include "tests/support/random_cameras.h"

#include <algorithm>
#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

// The painter himself: sorted from far to near, each point drawn over what is there.
torch::Tensor painted_in_order(std::vector<ColouredPoint> points, const Camera& camera) {
  const auto seen = [&](const ColouredPoint& point) {
    return Eigen::Vector3d(camera.camera_from_world() * point.x_in_world);
  };
  std::stable_sort(points.begin(), points.end(),
                   [&](const ColouredPoint& a, const ColouredPoint& b) { return seen(a).z() > seen(b).z(); });
  auto image = torch::zeros({3, camera.height, camera.width}, torch::kFloat64);
  for (const ColouredPoint& point : points) {
    const Eigen::Vector3d x = seen(point);
    if (x.z() <= 0) continue;
    const double u = std::floor(camera.intrinsics(0, 0) * x.x() / x.z() + camera.intrinsics(0, 2)),
                 v = std::floor(camera.intrinsics(1, 1) * x.y() / x.z() + camera.intrinsics(1, 2));
    if (u < 0 || v < 0 || u >= static_cast<double>(camera.width) || v >= static_cast<double>(camera.height))
      continue;
    for (int64_t channel = 0; channel < 3; ++channel) {
      image[channel][static_cast<int64_t>(v)][static_cast<int64_t>(u)] =
          point.rgb[static_cast<size_t>(channel)] / 255.0;
    }
  }
  return image;
}

TEST(PaintedCloud, FollowsThePaintersRuleOnAHundredClouds) {
  test::RandomCameras random(1);
  for (int cloud = 0; cloud < 100; ++cloud) {
    const Camera camera = random.ordinary(9, 7);
    std::vector<ColouredPoint> points;
    points.reserve(300);
    for (int i = 0; i < 300; ++i) {
      points.push_back(
          {random.vector(4),
           {static_cast<uint8_t>(random.integer(0, 255)), static_cast<uint8_t>(random.integer(0, 255)),
            static_cast<uint8_t>(random.integer(0, 255))}});
    }
    // Two points in one place: the later one is on top.
    points.push_back({points.front().x_in_world, {1, 2, 3}});
    ASSERT_TRUE(torch::equal(painted_cloud(points, camera), painted_in_order(points, camera))) << cloud;
  }
}

TEST(ColouredPoints, ArePixelsWithKnownDepthInEightBits) {
  const test::PlaneRoom room(2, 8, 6);
  auto depth = room.depth_maps();
  depth[0][0][0] = 0;
  depth[1][5][7] = std::nan("");
  const auto images = torch::full({2, 3, 6, 8}, 0.5, torch::kFloat64);
  const auto points = coloured_points(images, depth, room.cameras);
  ASSERT_EQ(points.size(), 2U * 48 - 2);
  EXPECT_EQ(points[0].rgb[0], 128);
  EXPECT_LT((points[0].x_in_world - room.point(room.cameras[0], 1.5, 0.5)).norm(), 1e-12);
  EXPECT_THAT(test::error_of([&] { coloured_points(images, depth.narrow(1, 0, 5), room.cameras); }),
              testing::HasSubstr("resize the depth to the cameras"));
}

TEST(DepthRoundTrip, IsZeroForAPerfectRenderer) {
  const test::PlaneRoom room(3, 40, 30);
  const RoundTrip found = depth_round_trip(room.depth_maps(), room.cameras);
  EXPECT_LT(found.pixels, 1e-9);
  EXPECT_NEAR(found.agreement, 1, 1e-12);
}

// Returns Spearman's rank correlation with 0, 1, 2, ...
double spearman_with_rank(const std::vector<double>& values) {
  double squares = 0;
  const auto n = static_cast<double>(values.size());
  for (size_t i = 0; i < values.size(); ++i) {
    const auto rank =
        std::count_if(values.begin(), values.end(), [&](double value) { return value < values[i]; });
    const double difference = static_cast<double>(rank) - static_cast<double>(i);
    squares += difference * difference;
  }
  return 1 - 6 * squares / (n * (n * n - 1));
}

// Returns the views with every one but the first turned and moved by random amounts of that size.
std::vector<Camera> disturbed(const std::vector<Camera>& cameras, double noise) {
  test::RandomCameras random(5);
  auto result = cameras;
  for (size_t i = 1; i < result.size(); ++i) {
    const Eigen::Vector3d axis = random.vector(1).normalized(), step = random.vector(1);
    result[i].world_from_camera.linear() =
        result[i].world_from_camera.linear() * Eigen::AngleAxisd(noise, axis).toRotationMatrix();
    result[i].world_from_camera.translation() += noise * step;
  }
  return result;
}

TEST(Reprojection, GrowsWithTheErrorOfTheCameras) {
  const test::PlaneRoom room(4, 48, 36);
  MetricInputs inputs;
  inputs.view_images = room.textures(3);
  inputs.view_depth = room.depth_maps();
  inputs.perceptual_distance = [](const torch::Tensor& a, const torch::Tensor& b) {
    return (a - b).abs().mean({1, 2, 3});
  };
  std::vector<double> scores, pixels;
  for (int i = 0; i < 12; ++i) {
    inputs.estimated_cameras = disturbed(room.cameras, 0.004 * i);
    scores.push_back(measure(metric_named("reprojection_score"), inputs).mean());
    pixels.push_back(measure(metric_named("reprojection_pixels"), inputs).mean());
    const double mse = measure(metric_named("reprojection_mse"), inputs).mean(),
                 perceptual = measure(metric_named("reprojection_perceptual"), inputs).mean();
    EXPECT_NEAR(scores.back(), mse + perceptual, 1e-7);
  }
  EXPECT_LT(measure(metric_named("reprojection_mse"),
                    [&] {
                      inputs.estimated_cameras = room.cameras;
                      return inputs;
                    }())
                .mean(),
            1e-3);
  EXPECT_GT(spearman_with_rank(scores), 0.95);
  EXPECT_GT(spearman_with_rank(pixels), 0.95);
  // A wall that slides along itself comes back to where it started: the other score sees that, this one hardly.
  EXPECT_GT(pixels.back(), 0.02);
}

// What does not agree is left out of the distance, so its share is a number of its own.
TEST(Reprojection, WhatIsLeftOutIsReported) {
  const test::PlaneRoom room(2, 40, 30);
  auto depth = room.depth_maps();
  depth[1].narrow(0, 0, 15) *= 3;
  const RoundTrip found = depth_round_trip(depth, room.cameras);
  EXPECT_LT(found.pixels, 1e-9);
  EXPECT_LT(found.agreement, 0.7);
  EXPECT_GT(found.agreement, 0.3);
}

// Cameras that all stand at one place reproject perfectly onto each other; that is not hidden.
TEST(Reprojection, CollapsedCamerasHaveABaselineRatioOfZero) {
  const test::PlaneRoom room(3, 16, 12);
  MetricInputs inputs;
  inputs.views.cameras = room.cameras;
  inputs.views.num_sources = 1;
  inputs.view_images = torch::rand({3, 3, 12, 16});
  inputs.all_true_depth = room.depth_maps();
  const auto ratio = [&] { return measure(metric_named("reprojection_baseline_ratio"), inputs); };
  // The unit of the prediction does not count.
  inputs.estimated_cameras = room.cameras;
  for (Camera& camera : inputs.estimated_cameras) camera.world_from_camera.translation() *= 5;
  inputs.view_depth = room.depth_maps() * 5;
  EXPECT_NEAR(ratio().mean(), 1, 1e-12);
  for (Camera& camera : inputs.estimated_cameras) camera = room.cameras[0];
  inputs.view_depth = room.depth_maps()[0].expand({3, 12, 16});
  EXPECT_LT(measure(metric_named("reprojection_pixels"), inputs).mean(), 1e-9);
  EXPECT_NEAR(ratio().mean(), 0, 1e-12);
  for (Camera& camera : inputs.views.cameras) camera = room.cameras[0];
  EXPECT_EQ(ratio().absent, "the scene's cameras stand at one place, or no depth is known");
}

TEST(Reprojection, IsAbsentWhereNoViewSeesAnother) {
  test::PlaneRoom room(2, 10, 8);
  const auto depth = room.depth_maps();
  room.cameras[1].world_from_camera.translation().x() += 1000;
  MetricInputs inputs;
  inputs.view_images = torch::rand({2, 3, 8, 10});
  inputs.view_depth = depth;
  inputs.estimated_cameras = room.cameras;
  EXPECT_EQ(measure(metric_named("reprojection_pixels"), inputs).absent,
            "no pixel of a view is seen in another one");
}

}  // namespace
}  // namespace gld
