#include "gld/cameras/scale_from_known_depth.h"

#include "tests/support/textured_plane.h"

#include <random>

#include <gtest/gtest.h>

namespace gld {
namespace {

constexpr double kUnit = 0.4;  // of the predicted depth, in the world

std::vector<DepthView> views_of_plane(const test::TexturedPlane& plane) {
  std::vector<DepthView> views;
  for (const double x : {0.0, 0.8}) {
    const Camera camera = test::camera_before_plane({x, 0, 0}, -0.1 * x);
    views.push_back({camera, plane.seen_by(camera, kUnit, false).depth});
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
  const auto scale = scale_from_sparse_points(views_of_plane(plane), points);
  ASSERT_TRUE(scale.has_value());
  EXPECT_EQ(scale->estimator, "sparse_points");
  EXPECT_NEAR(scale->scale, kUnit, 0.02 * kUnit);
  EXPECT_LE(scale->low, kUnit);
  EXPECT_GE(scale->high, kUnit);
  EXPECT_FALSE(scale_from_sparse_points(views_of_plane(plane), {points[0], points[2]}).has_value());
  EXPECT_FALSE(scale_from_sparse_points(views_of_plane(plane), {}).has_value());
}

TEST(ScaleFromKnownDepth, MeasuredDepthOfOneViewIsEnough) {
  const test::TexturedPlane plane;
  const auto views = views_of_plane(plane);
  const PlanarDepth measured = plane.seen_by(views[1].camera, 1, false).depth;
  const auto scale = scale_from_measured_depth(views, {PlanarDepth(), measured});
  ASSERT_TRUE(scale.has_value());
  EXPECT_EQ(scale->estimator, "source_depth");
  EXPECT_NEAR(scale->scale, kUnit, 0.01 * kUnit);
  EXPECT_FALSE(scale_from_measured_depth(views, {}).has_value());
  EXPECT_FALSE(scale_from_measured_depth(views, {PlanarDepth(), PlanarDepth()}).has_value());
}

}  // namespace
}  // namespace gld
