#include "gld/metrics/scene_bootstrap.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(Bootstrap, HasTheWidthOfTheStandardErrorForManyScenes) {
  std::vector<double> values;
  values.reserve(400);
  for (int i = 0; i < 400; ++i) values.push_back(10 + (i % 2 == 0 ? 1.0 : -1.0));  // deviation 1
  const MeanInterval interval = bootstrap_mean_interval(values);
  EXPECT_NEAR(interval.high - 10, 1.96 / 20, 0.008);
  EXPECT_NEAR(10 - interval.low, 1.96 / 20, 0.008);
}

TEST(Bootstrap, IsTheSameForTheSameSeedAndFollowsSkew) {
  const std::vector<double> values{1, 1, 1, 1, 1, 1, 1, 9};
  const MeanInterval a = bootstrap_mean_interval(values, 3), b = bootstrap_mean_interval(values, 3);
  EXPECT_EQ(a.low, b.low);
  EXPECT_EQ(a.high, b.high);
  EXPECT_EQ(a.low, 1);  // an interval of symmetric width would reach below every value
  EXPECT_GT(a.high, 3);
}

TEST(Bootstrap, SaysNothingOfOneScene) {
  EXPECT_TRUE(std::isnan(bootstrap_mean_interval({4}).low));
  EXPECT_TRUE(std::isnan(bootstrap_mean_interval({}).high));
  const double none = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(bootstrap_mean_interval({2, none, 2, std::numeric_limits<double>::infinity()}).high, 2);
}

}  // namespace
}  // namespace gld
