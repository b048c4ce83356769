#include "ablate/statistics/verdict.h"

#include <limits>
#include <string>
#include <vector>

#include <gmock/gmock.h>
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

// One claim alone, judged as of trainings.
Comparison judged(const NumbersBySeed& gain) {
  std::vector<Comparison> claims{compare(gain)};
  judge(claims, SeedsOf::kTrainings);
  return claims.front();
}

TEST(Verdict, IsReproducedOrOppositeWhereIntervalAndSeedsAgree) {
  const Comparison better = judged(around({0.5, 0.6, 0.4}, 64));
  EXPECT_EQ(better.verdict, Verdict::kHolds);
  EXPECT_EQ(better.reason, "");
  EXPECT_NEAR(better.mean, 0.5, 1e-12);
  EXPECT_EQ(better.signs.positive, 64);
  EXPECT_EQ(better.seeds_in_favour, 3);
  EXPECT_EQ(judged(around({-0.5, -0.6, -0.4}, 64)).verdict, Verdict::kOpposite);
  EXPECT_EQ(verdict_name(Verdict::kOpposite, ""), "opposite");
}

TEST(Verdict, IsUndecidedForOneReasonThatItSays) {
  const Comparison few = judged(around({0.5, 0.5}, 63));
  EXPECT_EQ(few.verdict, Verdict::kUndecided);
  EXPECT_EQ(few.reason, "63 scenes, a verdict needs 64");
  EXPECT_EQ(judged(around({0.5}, 64)).reason, "1 seed, a verdict needs 3");
  EXPECT_EQ(judged(around({0.5, 0.6}, 64)).reason, "2 seeds, a verdict needs 3");
  EXPECT_EQ(
      judged(around({0.001, -0.001, 0.001}, 64)).reason,
      "the interval contains 0; more than 1000 times as many scenes and seeds would decide, if the mean stays");
  EXPECT_EQ(judged(around({0.5, 0.5, 0.5}, 64)).reason,
            "all seeds gave the same numbers, which counts as one seed");
  EXPECT_EQ(judged({}).reason, "0 scenes, a verdict needs 64");
}

// One scene is drawn again and again: its p-value is the least there can be, and would take the first of Holm's ranks.
TEST(Verdict, ClaimsOfFewScenesMakeNoOtherOneEasier) {
  std::vector<Comparison> claims{compare(around({0.5, 0.6}, 1)), compare(around({0.5, 0.6}, 7)),
                                 compare(around({0.03, 0.032}, 64))};
  EXPECT_LT(claims[0].p_value, 0.001);
  judge(claims, SeedsOf::kEvaluations);
  EXPECT_EQ(claims[0].p_value, 1);
  EXPECT_EQ(claims[1].holm_p_value, 1);
  EXPECT_NEAR(claims[2].holm_p_value, 3 * claims[2].p_value, 1e-12);
}

TEST(Verdict, IsUndecidedWhereSeedsDisagreeThoughTheIntervalLiesOnOneSide) {
  // Nine seeds of 1 and one of -0.5: draws of ten seeds have a mean below 0 once in some thousands.
  const Comparison mixed = judged(around({1, 1, 1, 1, 1, 1, 1, 1, 1, -0.5}, 64));
  EXPECT_GT(mixed.interval.low, 0);
  EXPECT_EQ(mixed.verdict, Verdict::kUndecided);
  EXPECT_EQ(mixed.reason, "the seeds disagree: 9 of 10 in favour");
}

TEST(Verdict, SaysHowMuchMoreWouldDecide) {
  // p-values of one, two and three deviations.
  EXPECT_NEAR(times_as_much(0.317310508, 0.045500264), 4, 1e-6);
  EXPECT_NEAR(times_as_much(0.045500264, 0.002699796), 2.25, 1e-6);
  EXPECT_NEAR(times_as_much(0.2, 0.2), 1, 1e-9);
  EXPECT_EQ(times_as_much(1, 0.05), std::numeric_limits<double>::infinity());
}

// Holm's correction goes up to the first claim that fails, and none is above 1.
TEST(Verdict, SaysHowMuchMoreWouldDecideAmongOthers) {
  const auto reason_of_last = [](const std::vector<double>& p_values) {
    std::vector<Comparison> claims;
    for (const double p : p_values) {
      Comparison claim;
      claim.p_value = p;
      claim.scenes = 64;
      claim.seeds = 2;
      claim.interval = {-1, 1};
      claims.push_back(claim);
    }
    judge(claims, SeedsOf::kEvaluations);
    return claims.back().reason;
  };
  const auto says = [](const char* times) {
    return "the interval contains 0; about " + std::string(times) +
           " times as many scenes and seeds would decide, if the mean stays";
  };
  // (2.2414 / 0.5129)^2: .05 of two, though twice .608 is no p-value.
  EXPECT_EQ(reason_of_last({0.99, 0.608}), says("19"));
  // .118 needs (2.2414 / 1.5632)^2 = 2.06, .104 before it (2.3940 / 1.6258)^2 = 2.17.
  EXPECT_EQ(reason_of_last({0.82, 0.104, 0.118}), says("2.2"));
  EXPECT_EQ(reason_of_last({0.82, 0.118}), says("2.1"));
}

TEST(Verdict, OfEvaluationsNeedsTwoSeeds) {
  std::vector<Comparison> claims{compare(around({0.5, 0.6}, 64))};
  judge(claims, SeedsOf::kEvaluations);
  EXPECT_EQ(claims[0].verdict, Verdict::kHolds);
}

TEST(Verdict, OfManyClaimsNeedsMoreThanEachAlone) {
  // Means of 64 scenes at 2.4 of their own deviations: p near 0.016, which is enough alone and not among six.
  const NumbersBySeed weak = around({0.0299, 0.030, 0.0301}, 64);
  const Comparison alone = judged(weak);
  EXPECT_EQ(alone.verdict, Verdict::kHolds);
  EXPECT_EQ(alone.holm_p_value, alone.p_value);
  EXPECT_GT(alone.p_value, 0.0125);
  EXPECT_LT(alone.p_value, 0.025);
  std::vector<Comparison> claims(4, compare(weak));
  claims.push_back(compare(around({0.5, 0.501, 0.499}, 64)));
  Comparison left_out;
  left_out.reason = "not run";
  claims.push_back(left_out);
  judge(claims, SeedsOf::kTrainings);
  EXPECT_EQ(claims[0].verdict, Verdict::kUndecided);
  EXPECT_EQ(claims[0].holm_p_value, 5 * claims[0].p_value);  // the strong one comes first, of six
  EXPECT_EQ(claims[0].reason.rfind("clear of 0 alone, not among 6 claims: p 0.0", 0), 0U) << claims[0].reason;
  // .05 among six is 2.64 deviations, 1.21 times as much as 2.4 of them.
  EXPECT_THAT(claims[0].reason,
              testing::HasSubstr("; about 1.2 times as many scenes and seeds would decide"));
  EXPECT_EQ(claims[4].verdict, Verdict::kHolds);
  EXPECT_EQ(claims[4].holm_p_value, 6 * claims[4].p_value);
  EXPECT_EQ(claims[5].reason, "not run");
  EXPECT_EQ(claims[5].verdict, Verdict::kUndecided);
}

TEST(Verdict, OfTrainingsThatDifferIsNotDecidedByTheirScenes) {
  // Three trainings of one sign by chance: replicates of them have one sign too, their spread says that it is chance.
  const NumbersBySeed chance = around({0.1, 0.9, 0.4}, 64);
  const Comparison by_trainings = judged(chance);
  EXPECT_GT(by_trainings.interval.low, 0);
  EXPECT_EQ(by_trainings.verdict, Verdict::kUndecided);
  EXPECT_EQ(
      by_trainings.reason,
      "p 0.18, a verdict needs less than 0.05; about 2.2 times as many scenes and seeds would decide, if the mean stays");
  std::vector<Comparison> by_evaluations{compare(chance)};
  judge(by_evaluations, SeedsOf::kEvaluations);
  EXPECT_EQ(by_evaluations[0].verdict, Verdict::kHolds);
}

}  // namespace
}  // namespace gld
