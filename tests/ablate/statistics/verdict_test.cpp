#include "ablate/statistics/verdict.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

// Differences around a mean: half of the scenes 0.1 above it, half below.
NumbersBySeed around(const std::vector<double>& mean_of_seed, int64_t scenes) {
  NumbersBySeed gain;
  for (size_t seed = 0; seed < mean_of_seed.size(); ++seed) {
    for (int64_t scene = 0; scene < scenes; ++scene) {
      gain[static_cast<int64_t>(seed)]["scene_" + std::to_string(scene)] =
          mean_of_seed[seed] + (scene % 2 == 0 ? 0.1 : -0.1);
    }
  }
  return gain;
}

TEST(Verdict, IsReproducedOrOppositeWhereIntervalAndSeedsAgree) {
  const Comparison better = compare(around({0.5, 0.6, 0.4}, 64));
  EXPECT_EQ(better.verdict, Verdict::kReproduced);
  EXPECT_EQ(better.reason, "");
  EXPECT_NEAR(better.mean, 0.5, 1e-12);
  EXPECT_EQ(better.signs.positive, 64);
  EXPECT_EQ(better.seeds_in_favour, 3);
  EXPECT_EQ(compare(around({-0.5, -0.6, -0.4}, 64)).verdict, Verdict::kOpposite);
  EXPECT_EQ(verdict_name(Verdict::kOpposite), "opposite");
}

TEST(Verdict, IsUndecidedForOneReasonThatItSays) {
  const Comparison few = compare(around({0.5, 0.5}, 63));
  EXPECT_EQ(few.verdict, Verdict::kUndecided);
  EXPECT_EQ(few.reason, "63 scenes, a verdict needs 64");
  EXPECT_EQ(compare(around({0.5}, 64)).reason, "one seed, a verdict needs 2");
  EXPECT_EQ(compare(around({0.001, -0.001}, 64)).reason, "the interval contains 0");
  EXPECT_EQ(compare({}).reason, "0 scenes, a verdict needs 64");
}

TEST(Verdict, IsUndecidedWhereSeedsDisagreeThoughTheIntervalLiesOnOneSide) {
  // Nine seeds of 1 and one of -0.5: draws of ten seeds have a mean below 0 once in some thousands.
  const Comparison mixed = compare(around({1, 1, 1, 1, 1, 1, 1, 1, 1, -0.5}, 64));
  EXPECT_GT(mixed.interval.low, 0);
  EXPECT_EQ(mixed.verdict, Verdict::kUndecided);
  EXPECT_EQ(mixed.reason, "the seeds disagree: 9 of 10 in favour");
}

}  // namespace
}  // namespace gld
