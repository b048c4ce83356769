#include "gld/metrics/cloud_metrics.h"

#include "gld/metrics/metric_list.h"

#include <cmath>

#include <gtest/gtest.h>

namespace gld {
namespace {

// Returns a square of side 2 at x = y = 1e6, with a point every 0.02.
torch::Tensor square() {
  const auto line = torch::linspace(0, 2, 101, torch::kFloat64) + 1e6;
  const auto grid = torch::meshgrid({line, line}, "ij");
  return torch::stack({grid[0].flatten(), grid[1].flatten(), torch::zeros({101 * 101}, torch::kFloat64)}, 1);
}

TEST(CloudMetrics, DistanceIsToTheNearestPointOfTheSurface) {
  const auto surface = square();
  EXPECT_NEAR(largest_side(surface), 2, 1e-9);
  auto points = surface.slice(0, 0, surface.size(0), 7).clone();
  EXPECT_NEAR(median_cloud_distance(points, surface), 0, 1e-6);
  points.select(1, 2).fill_(0.3);
  EXPECT_NEAR(median_cloud_distance(points, surface), 0.3, 1e-6);
  // A minority far away does not count.
  points.slice(0, 0, points.size(0) / 3).select(1, 2).fill_(50);
  EXPECT_NEAR(median_cloud_distance(points, surface), 0.3, 1e-6);
  EXPECT_TRUE(std::isnan(median_cloud_distance(torch::empty({0, 3}, torch::kFloat64), surface)));
}

TEST(CloudMetrics, AreSharesOfTheSceneAndOfTheTrueScale) {
  MetricInputs inputs;
  EXPECT_NE(measure(metric_named("cloud_distance"), inputs).absent, "");
  inputs.true_surface = square();
  inputs.cloud = square();
  inputs.cloud.select(1, 2).fill_(0.1);
  EXPECT_NEAR(measure(metric_named("cloud_distance"), inputs).mean(), 0.05, 1e-6);
  inputs.true_depth = torch::full({1, 2, 2}, 6.0);
  inputs.depth = torch::full({1, 2, 2}, 2.0);
  EXPECT_NE(measure(metric_named("depth_scale_ratio"), inputs).absent, "");
  inputs.depth_scale = 3.3;
  EXPECT_NEAR(measure(metric_named("depth_scale_ratio"), inputs).mean(), 1.1, 1e-9);
}

}  // namespace
}  // namespace gld
