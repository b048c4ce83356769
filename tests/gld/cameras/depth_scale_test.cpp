#include "gld/cameras/depth_scale.h"

#include <cmath>
#include <random>

#include <gtest/gtest.h>

namespace gld {
namespace {

using Eigen::Vector3d;

// Cameras along an arc in a model's frame, and the same in a world where one unit of the model is 2.5 long; the world's
// centres are off by that much.
struct ArcPair {
  std::vector<Camera> in_model, in_world;
};

ArcPair arc(double noise, uint64_t seed) {
  std::mt19937_64 generator(seed);
  std::normal_distribution<double> normal;
  ArcPair pair;
  for (int i = 0; i < 6; ++i) {
    Camera camera;
    camera.world_from_camera.translation() = Vector3d(std::cos(0.3 * i), 0.2 * i, std::sin(0.3 * i));
    pair.in_model.push_back(camera);
    camera.world_from_camera.translation() *= 2.5;
    camera.world_from_camera.translation() +=
        noise * Vector3d(normal(generator), normal(generator), normal(generator)) + Vector3d(7, 8, 9);
    pair.in_world.push_back(camera);
  }
  return pair;
}

TEST(DepthScale, ExactPosesLeaveNoDoubt) {
  const ArcPair pair = arc(0, 1);
  const auto scale = depth_scale_from_poses(align_poses(pair.in_model, pair.in_world));
  ASSERT_TRUE(scale.has_value());
  EXPECT_EQ(scale->estimator, "camera_poses");
  EXPECT_NEAR(scale->scale, 2.5, 1e-12);
  EXPECT_NEAR(scale->low, 2.5, 1e-9);
  EXPECT_NEAR(scale->high, 2.5, 1e-9);
  EXPECT_NEAR(scale->residual, 0, 1e-9);
}

// Two standard errors hold the truth in about 95 of 100 cases.
TEST(DepthScale, TheIntervalHoldsTheTruthAsOftenAsItSays) {
  int inside = 0;
  double widths = 0;
  constexpr int kTrials = 400;
  for (uint64_t seed = 0; seed < kTrials; ++seed) {
    const ArcPair pair = arc(0.1, seed);
    const auto scale = depth_scale_from_poses(align_poses(pair.in_model, pair.in_world));
    ASSERT_TRUE(scale.has_value());
    EXPECT_GT(scale->residual, 0);
    EXPECT_LT(scale->residual, 0.3);
    inside += scale->low <= 2.5 && 2.5 <= scale->high ? 1 : 0;
    widths += (scale->high - scale->low) / kTrials;
  }
  EXPECT_GT(inside, kTrials * 90 / 100);
  EXPECT_LT(inside, kTrials * 99 / 100);
  EXPECT_LT(widths, 0.6);
}

TEST(DepthScale, NothingWhereTheCamerasStandAtOnePlace) {
  const std::vector<Camera> cameras(3);
  EXPECT_FALSE(depth_scale_from_poses(align_poses(cameras, cameras)).has_value());
}

TEST(DepthScale, TheSurestEstimateIsTaken) {
  EXPECT_FALSE(surest_depth_scale({}).has_value());
  DepthScale wide, narrow;
  wide.estimator = "wide";
  wide.low = 0.5;
  wide.high = 2;
  narrow.estimator = "narrow";
  narrow.scale = 100;  // relative to the scale its interval is the narrower one
  narrow.low = 90;
  narrow.high = 110;
  EXPECT_EQ(surest_depth_scale({wide, narrow})->estimator, "narrow");
}

}  // namespace
}  // namespace gld
