#include "gld/photogrammetry/scale_from_known_depth.h"

#include "tests/support/textured_plane.h"

#include <cmath>
#include <optional>
#include <random>

#include <gtest/gtest.h>

namespace gld {
namespace {

constexpr double kKnownUnit = 0.4;  // of the predicted depth, in the world

std::vector<DepthView> depth_of_plane(const test::TexturedPlane& plane) {
  std::vector<DepthView> views;
  for (const double x : {0.0, 0.8}) {
    const Camera camera = test::camera_before_plane({x, 0, 0}, -0.1 * x);
    views.push_back({camera, plane.seen_by(camera, kKnownUnit, false).depth});
  }
  return views;
}

// Points on the plane, and as many far behind it, which the views do not see.
TEST(ScaleFromKnownDepth, SparsePointsBehindTheSurfaceDoNotCount) {
  const test::TexturedPlane plane;
  std::mt19937_64 generator(1);
  std::uniform_real_distribution<double> side(-1.5, 1.5), behind(1.2, 8);
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < 400; ++i) {
    Eigen::Vector3d point(side(generator), side(generator), 0);
    point.z() = (plane.distance - plane.normal.dot(point)) / plane.normal.z();
    points.push_back(i % 2 == 0 ? point : point * behind(generator));
  }
  const auto scale = scale_from_sparse_points(depth_of_plane(plane), points);
  ASSERT_TRUE(scale.has_value());
  EXPECT_EQ(scale->estimator, "sparse_points");
  EXPECT_NEAR(scale->scale, kKnownUnit, 0.02 * kKnownUnit);
  EXPECT_LE(scale->low, kKnownUnit);
  EXPECT_GE(scale->high, kKnownUnit);
  EXPECT_FALSE(scale_from_sparse_points(depth_of_plane(plane), {points[0], points[2]}).has_value());
  EXPECT_FALSE(scale_from_sparse_points(depth_of_plane(plane), {}).has_value());
}

TEST(ScaleFromKnownDepth, MeasuredDepthOfOneViewIsEnough) {
  const test::TexturedPlane plane;
  const auto views = depth_of_plane(plane);
  const PlanarDepth measured = plane.seen_by(views[1].camera, 1, false).depth;
  const auto scale = scale_from_measured_depth(views, {PlanarDepth(), measured}, "source_depth");
  ASSERT_TRUE(scale.has_value());
  EXPECT_EQ(scale->estimator, "source_depth");
  EXPECT_NEAR(scale->scale, kKnownUnit, 0.01 * kKnownUnit);
  EXPECT_FALSE(scale_from_measured_depth(views, {}, "source_depth").has_value());
  EXPECT_FALSE(scale_from_measured_depth(views, {PlanarDepth(), PlanarDepth()}, "source_depth").has_value());
}

// Predicted depth that is 22 % too near at the left and as much too far at the right, known in that share of the view
// at its left.
std::optional<DepthScale> scale_where_known(double share) {
  const test::TexturedPlane plane;
  auto views = depth_of_plane(plane);
  PlanarDepth measured = plane.seen_by(views[0].camera, 1, false).depth;
  for (int64_t y = 0; y < measured.height; ++y) {
    for (int64_t x = 0; x < measured.width; ++x) {
      const double right = (static_cast<double>(x) + 0.5) / static_cast<double>(measured.width);
      const auto pixel = static_cast<size_t>(y * measured.width + x);
      views[0].depth.values[pixel] *= static_cast<float>(std::exp(0.4 * (right - 0.5)));
      if (right > share) measured.values[pixel] = 0;
    }
  }
  return scale_from_measured_depth({views[0]}, {measured}, "photographs");
}

// What is known in the left three fifths says a scale that is 8 % off that of the whole, and the interval says so.
TEST(ScaleFromKnownDepth, TheIntervalHoldsWherePredictedDepthHasAnotherShape) {
  const auto scale = scale_where_known(0.6);
  ASSERT_TRUE(scale.has_value());
  EXPECT_NEAR(std::log(scale->scale / kKnownUnit), 0.08, 0.03);
  EXPECT_LE(scale->low, kKnownUnit);
  EXPECT_GE(scale->high, kKnownUnit);
}

// What is known in the left quarter alone says less of the whole than what is known in half of it.
TEST(ScaleFromKnownDepth, TheIntervalIsWiderTheLessIsKnown) {
  const auto quarter = scale_where_known(0.25), half = scale_where_known(0.5), all = scale_where_known(1);
  ASSERT_TRUE(quarter && half && all);
  const auto width = [](const DepthScale& scale) {
    return std::log(scale.high / scale.low) / scale.residual;
  };
  // 4 deviations of sqrt((1 / seen - 1) / 2) times what the fit leaves.
  EXPECT_NEAR(width(*quarter), 4 * 1.4826 * std::sqrt(3 / 2.0), 1e-6);
  EXPECT_NEAR(width(*half), 4 * 1.4826 * std::sqrt(1 / 2.0), 1e-6);
  EXPECT_NEAR(width(*all), 4 * 1.4826 * std::sqrt(1 / 2.0), 1e-6);  // known by texture, which is no fair draw
}

}  // namespace
}  // namespace gld
