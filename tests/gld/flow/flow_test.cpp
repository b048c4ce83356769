#include "gld/flow/flow.h"

#include "gld/flow/schedule.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

struct Pair {
  torch::Tensor data, noise;
};

Pair random_pair() {
  torch::manual_seed(1);
  return {torch::randn({3, 5}, torch::kFloat64), torch::randn({3, 5}, torch::kFloat64)};
}

TEST(Flow, VelocityGivesBackDataAndNoiseAtEveryTimeBothEndsIncluded) {
  const auto [data, noise] = random_pair();
  const auto velocity = velocity_target(data, noise);
  for (const double t : {0.0, 1e-12, 0.3, 0.97, 1.0}) {
    const auto x = interpolate(data, noise, t);
    EXPECT_TRUE(torch::allclose(data_from_velocity(x, velocity, t), data, 0, 1e-14)) << t;
    EXPECT_TRUE(torch::allclose(noise_from_velocity(x, velocity, t), noise, 0, 1e-14)) << t;
    EXPECT_TRUE(torch::allclose(scaled_score_from_velocity(x, velocity, t), -noise, 0, 1e-14)) << t;
  }
}

TEST(Flow, ScoreOfASingleGaussian) {
  // The data has variance s: x_t is normal with variance (1 - t)^2 s + t^2, whose score is -x over it.
  const double s = 0.3;
  const auto x = random_pair().data;
  for (const double t : {1e-6, 0.2, 1.0}) {
    const double variance = (1 - t) * (1 - t) * s + t * t;
    const auto velocity = x * (t / variance - (1 - t) * s / variance);
    EXPECT_TRUE(torch::allclose(scaled_score_from_velocity(x, velocity, t), -x * (t / variance), 1e-6)) << t;
  }
}

TEST(Flow, TimeShiftOfThePaper) {
  EXPECT_NEAR(time_shift_of({8, 36, 36}, 1536), 62.35, 0.01);
  EXPECT_NEAR(shifted_time(0.001, time_shift_of({8, 36, 36}, 1536)), 0.0587, 1e-4);
  EXPECT_EQ(resolved_time_shift(0, {8, 36, 36}, 1536), time_shift_of({8, 36, 36}, 1536));
  EXPECT_EQ(resolved_time_shift(19.6, {8, 36, 36}, 1536), 19.6);
}

}  // namespace
}  // namespace gld
