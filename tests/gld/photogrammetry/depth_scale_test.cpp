#include "gld/photogrammetry/depth_scale.h"

#include <cmath>
#include <functional>
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
        noise * Vector3d{normal(generator), normal(generator), normal(generator)} + Vector3d(7, 8, 9);
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

TEST(DepthScale, AnIndependentErrorWidensTheInterval) {
  DepthScale estimate;
  estimate.scale = 2;
  estimate.low = 2 * std::exp(-0.6);
  estimate.high = 2 * std::exp(0.3);
  const DepthScale wider = with_log_deviation(estimate, 0.4);
  EXPECT_EQ(wider.scale, 2);
  EXPECT_NEAR(std::log(wider.low / 2), -std::hypot(0.6, 0.8), 1e-12);
  EXPECT_NEAR(std::log(wider.high / 2), std::hypot(0.3, 0.8), 1e-12);
  EXPECT_EQ(doubt_about(with_log_deviation(estimate, 0)), "");
  EXPECT_EQ(doubt_about(wider), "it may be anything from 0.736 to 4.7");
}

// Returns in how many of 400 cases the interval holds the truth, 2.5.
int intervals_with_the_truth(const std::function<ArcPair(uint64_t seed)>& pair_of) {
  int inside = 0;
  for (uint64_t seed = 0; seed < 400; ++seed) {
    const ArcPair pair = pair_of(seed);
    const auto scale = depth_scale_from_poses(align_poses(pair.in_model, pair.in_world));
    if (!scale) continue;
    EXPECT_GT(scale->residual, 0);
    inside += scale->low <= 2.5 && 2.5 <= scale->high ? 1 : 0;
  }
  return inside;
}

TEST(DepthScale, TheIntervalHoldsTheTruthWhereErrorsAreIndependent) {
  EXPECT_GE(intervals_with_the_truth([](uint64_t seed) { return arc(0.1, seed); }), 380);
  double widths = 0;
  for (uint64_t seed = 0; seed < 400; ++seed) {
    const ArcPair pair = arc(0.03, seed);
    const auto scale = depth_scale_from_poses(align_poses(pair.in_model, pair.in_world));
    EXPECT_EQ(doubt_about(*scale), "") << seed;
    widths += (scale->high - scale->low) / scale->scale / 400;
  }
  EXPECT_LT(widths, 0.3);
}

// What a network does not know of a camera's place draws that camera to the others: all baselines come out too short.
TEST(DepthScale, TheIntervalHoldsTheTruthWhereBaselinesAreTooShort) {
  const auto drawn_together = [](uint64_t seed) {
    ArcPair pair = arc(0, seed);
    std::mt19937_64 generator(seed);
    std::uniform_real_distribution<double> shrinks(0.5, 1);
    for (Camera& camera : pair.in_model) camera.world_from_camera.translation() *= shrinks(generator);
    return pair;
  };
  EXPECT_GE(intervals_with_the_truth(drawn_together), 360);
}

TEST(DepthScale, NothingWhereTheCamerasStandAtOnePlace) {
  const std::vector<Camera> cameras(3);
  EXPECT_FALSE(depth_scale_from_poses(align_poses(cameras, cameras)).has_value());
}

DepthScale estimate(const char* estimator, double low, double high, double residual = 0.1) {
  DepthScale made;
  made.estimator = estimator;
  made.scale = std::sqrt(low * high);
  made.low = low;
  made.high = high;
  made.residual = residual;
  return made;
}

TEST(DepthScale, EstimatesThatAgreeAreWeightedByTheirPrecision) {
  EXPECT_FALSE(combined_depth_scale({}).has_value());
  const auto both = combined_depth_scale({estimate("wide", 0.9, 1.6), estimate("narrow", 0.95, 1.05)});
  ASSERT_TRUE(both.has_value());
  EXPECT_EQ(both->estimator, "wide + narrow");
  EXPECT_GT(both->scale, estimate("narrow", 0.95, 1.05).scale);
  EXPECT_LT(both->scale, 1.02);
  EXPECT_LT(both->high / both->low, 1.05 / 0.95);
}

TEST(DepthScale, WhatContradictsTheSurestEstimateIsLeftOut) {
  const auto surest = combined_depth_scale({estimate("far off", 50, 60), estimate("surest", 2.4, 2.6)});
  ASSERT_TRUE(surest.has_value());
  EXPECT_EQ(surest->estimator, "surest");
  EXPECT_NEAR(surest->scale, std::sqrt(2.4 * 2.6), 1e-12);
}

// A narrow interval around a fit that explains nothing is no knowledge, and neither is a fit that explains all at any
// scale.
TEST(DepthScale, AnEstimateInDoubtIsNoScale) {
  const DepthScale unexplained = estimate("camera_poses", 580, 590, 0.93);
  const DepthScale open = estimate("photographs", 1, 5);
  EXPECT_EQ(doubt_about(unexplained), "its fit leaves 93 % of what it is fitted to");
  EXPECT_EQ(doubt_about(open), "it may be anything from 1 to 5");
  EXPECT_EQ(doubt_about(estimate("photographs", 2, 2.2)), "");
  // Where the limits lie.
  EXPECT_EQ(doubt_about(estimate("photographs", 2, 7.9, 0.39)), "");
  EXPECT_EQ(doubt_about(estimate("photographs", 2, 7.9, 0.41)),
            "its fit leaves 41 % of what it is fitted to");
  EXPECT_EQ(doubt_about(estimate("photographs", 2, 8.1, 0.39)), "it may be anything from 2 to 8.1");
  EXPECT_FALSE(combined_depth_scale({unexplained, open}).has_value());
}

// The shipped model's ray origins were like this: all at one place up to 1e-4, scattered by chance. That a scale fits
// best is not that it is known.
TEST(DepthScale, ScatteredCentresDoNotTellTheScale) {
  int believed = 0;
  for (uint64_t seed = 0; seed < 200; ++seed) {
    ArcPair pair = arc(0, seed);
    std::mt19937_64 generator(seed);
    std::normal_distribution<double> normal;
    for (Camera& camera : pair.in_model) {
      camera.world_from_camera.translation() =
          1e-4 * Vector3d{normal(generator), normal(generator), normal(generator)};
    }
    const auto scale = depth_scale_from_poses(align_poses(pair.in_model, pair.in_world));
    if (scale && doubt_about(*scale).empty()) ++believed;
  }
  EXPECT_LE(believed, 1);
}

// The same goes for cameras that look elsewhere.
TEST(DepthScale, OrientationsThatDoNotFitAreADoubt) {
  ArcPair pair = arc(0, 1);
  for (size_t i = 0; i < pair.in_model.size(); ++i) {
    pair.in_model[i].world_from_camera.linear() =
        Eigen::AngleAxisd(i % 2 == 0 ? 0.4 : -0.4, Vector3d::UnitX()).toRotationMatrix();
  }
  const auto scale = depth_scale_from_poses(align_poses(pair.in_model, pair.in_world));
  ASSERT_TRUE(scale.has_value());
  EXPECT_GT(scale->residual, 0.35);
  EXPECT_NE(doubt_about(*scale), "");
}

}  // namespace
}  // namespace gld
