#include "gld/photogrammetry/photo_consistency.h"

#include "tests/support/textured_plane.h"

#include <random>

#include <gtest/gtest.h>

namespace gld {
namespace {

using Eigen::Vector3d;
using test::camera_before_plane;

constexpr double kUnit = 2.5;  // of the depth, in the world

std::vector<PicturedView> views_of_plane(const Vector3d& offset = Vector3d::Zero()) {
  test::TexturedPlane plane;
  plane.distance += plane.normal.dot(offset);
  std::vector<PicturedView> views{
      plane.seen_by(camera_before_plane(offset, 0), kUnit),
      plane.seen_by(camera_before_plane(offset + Vector3d(0.7, 0.1, 0.1), -0.15), kUnit)};
  return views;
}

TEST(PhotoConsistency, FindsTheUnitOfExactDepth) {
  const auto scale = scale_from_photo_consistency(views_of_plane(), "photographs");
  ASSERT_TRUE(scale.has_value());
  EXPECT_EQ(scale->estimator, "photographs");
  EXPECT_NEAR(scale->scale, kUnit, 0.02 * kUnit);
  EXPECT_LE(scale->low, kUnit);
  EXPECT_GE(scale->high, kUnit);
  EXPECT_LT(scale->high / scale->low, 1.1);
  EXPECT_LT(scale->residual, 0.06);  // a step of the candidates
  EXPECT_EQ(doubt_about(*scale), "");
}

// The origin is as far away as scenes in map coordinates lie.
TEST(PhotoConsistency, TheOriginDoesNotMatter) {
  const auto scale = scale_from_photo_consistency(views_of_plane({3e5, -2e5, 100}), "photographs");
  ASSERT_TRUE(scale.has_value());
  // The waves are those of another piece of the plane.
  EXPECT_NEAR(scale->scale, kUnit, 0.03 * kUnit);
}

// Every pixel's depth is off by 15 %, and a fifth is wrong altogether.
TEST(PhotoConsistency, NoisyDepthKeepsTheScale) {
  auto views = views_of_plane();
  std::mt19937_64 generator(3);
  std::normal_distribution<double> normal;
  for (PicturedView& view : views) {
    // Errors of a model are the same over some pixels.
    for (int64_t y = 0; y < view.height; ++y) {
      double factor = 1;
      for (int64_t x = 0; x < view.width; ++x) {
        if (x % 16 == 0) factor = generator() % 5 == 0 ? 3 : std::exp(0.15 * normal(generator));
        view.depth.values[static_cast<size_t>((y / 16 * 16) * view.width + x)] *=
            y % 16 == 0 ? static_cast<float>(factor) : 1.0F;
        view.depth.values[static_cast<size_t>(y * view.width + x)] =
            view.depth.values[static_cast<size_t>((y / 16 * 16) * view.width + x)];
      }
    }
  }
  const auto scale = scale_from_photo_consistency(views, "photographs");
  ASSERT_TRUE(scale.has_value());
  EXPECT_NEAR(scale->scale, kUnit, 0.1 * kUnit);
}

// Between the photographs stands a view that was not taken, with depth of its own.
TEST(PhotoConsistency, DepthOfAnUnphotographedViewIsAskedToo) {
  auto views = views_of_plane();
  const test::TexturedPlane plane;
  // Its depth is 30 % too small: the scene's scale lies between.
  views.push_back(plane.seen_by(camera_before_plane({0.35, 0, 0}, -0.07), 1.3 * kUnit, false));
  const auto scale = scale_from_photo_consistency(views, "photographs");
  ASSERT_TRUE(scale.has_value());
  EXPECT_GT(scale->scale, 1.03 * kUnit);
  EXPECT_LT(scale->scale, 1.2 * kUnit);
  EXPECT_GE(scale->high, 1.15 * kUnit);  // and the interval says that views differ
}

TEST(PhotoConsistency, SaysNothingWhereNothingCanBeSeen) {
  auto on_the_spot = views_of_plane();
  on_the_spot[1].camera.world_from_camera.translation() =
      on_the_spot[0].camera.world_from_camera.translation();
  EXPECT_FALSE(scale_from_photo_consistency(on_the_spot, "photographs").has_value());
  auto without_texture = views_of_plane();
  for (PicturedView& view : without_texture) std::fill(view.rgb.begin(), view.rgb.end(), 0.5F);
  EXPECT_FALSE(scale_from_photo_consistency(without_texture, "photographs").has_value());
  EXPECT_FALSE(scale_from_photo_consistency({views_of_plane()[0]}, "photographs").has_value());
  auto unknown_depth = views_of_plane();
  for (PicturedView& view : unknown_depth)
    std::fill(view.depth.values.begin(), view.depth.values.end(), 0.0F);
  EXPECT_FALSE(scale_from_photo_consistency(unknown_depth, "photographs").has_value());
}

// Every window would vote for a depth that moves it out of the photograph that shows nothing.
TEST(PhotoConsistency, SaysNothingBesideAPhotographWithoutTexture) {
  auto views = views_of_plane();
  std::mt19937_64 generator(5);
  std::normal_distribution<float> noise(0.5F, 0.005F);
  for (float& value : views[1].rgb) value = noise(generator);
  EXPECT_FALSE(scale_from_photo_consistency(views, "photographs").has_value());
}

// Of what hardly moves photographs say that it is that far away or farther.
TEST(PhotoConsistency, SaysNothingOfWhatIsTooFarAway) {
  auto views = views_of_plane();
  views[1].rgb = views[0].rgb;
  views[1].depth = views[0].depth;
  views[1].camera.world_from_camera.linear() = views[0].camera.world_from_camera.linear();
  EXPECT_FALSE(scale_from_photo_consistency(views, "photographs").has_value());
}

// Photographs of two scenes agree nowhere.
TEST(PhotoConsistency, IsInDoubtWherePhotographsDoNotMatch) {
  auto views = views_of_plane();
  std::mt19937_64 generator(5);
  std::uniform_real_distribution<float> value(0, 1);
  for (float& brightness : views[1].rgb) brightness = value(generator);
  const auto scale = scale_from_photo_consistency(views, "photographs");
  EXPECT_TRUE(!scale || !doubt_about(*scale).empty());
}

TEST(PhotoConsistency, ComparesEachViewWithItsNearestPhotographs) {
  std::vector<Camera> cameras;
  for (const double x : {0.0, 1.0, 3.0, 1.2}) cameras.push_back(camera_before_plane({x, 0, 0}, 0));
  const auto chosen = comparisons_of(cameras, {true, true, true, false});
  ASSERT_GE(chosen.size(), 4U);
  const auto is = [&](size_t i, size_t view, size_t first, size_t second) {
    return chosen[i].view == view && chosen[i].first == first && chosen[i].second == second;
  };
  EXPECT_TRUE(is(0, 0, 0, 1));
  EXPECT_TRUE(is(1, 1, 1, 0));
  EXPECT_TRUE(is(2, 2, 2, 1));
  EXPECT_TRUE(is(3, 3, 1, 0));
  EXPECT_LE(chosen.size(), 24U);
}

}  // namespace
}  // namespace gld
