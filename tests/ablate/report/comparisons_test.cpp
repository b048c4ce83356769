#include "ablate/report/comparisons.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(PairedGain, ComparesOnlyTargetsThatBothHave) {
  // The first has an easy target more; on the common ones it is worse.
  const MeasuredNumbers first{{0, {{"room", {{"easy", 40}, {"far", 20}}}}}};
  const MeasuredNumbers second{{0, {{"room", {{"far", 21}}}}}};
  const NumbersBySeed expected{{0, {{"room", -1}}}};
  EXPECT_EQ(paired_gain(Better::kHigher, first, second), expected);
  const NumbersBySeed means{{0, {{"room", 30}}}};
  EXPECT_EQ(scene_means(first), means);
}

TEST(PairedGain, IsOfOneSeedAndSceneAndLeavesOutWhatIsNotFinite) {
  const double infinite = std::numeric_limits<double>::infinity();
  const MeasuredNumbers first{{0, {{"a", {{"", 1}}}, {"b", {{"", infinite}}}}}, {1, {{"a", {{"", 5}}}}}};
  const MeasuredNumbers second{{0, {{"a", {{"", 3}}}, {"b", {{"", infinite}}}}}, {2, {{"a", {{"", 5}}}}}};
  const NumbersBySeed expected{{0, {{"a", 2}}}};
  EXPECT_EQ(paired_gain(Better::kLower, first, second), expected);
}

TEST(JudgeClaims, JudgesByTheMetricsDirectionAndSaysWhatWasNotRun) {
  Ablation ablation;
  ablation.options.bootstrap = 200;
  MetricDescription error;
  error.name = error.column = "error";
  error.better = "lower";
  ablation.metrics.push_back(error);
  for (const char* name : {"small", "large"}) {
    VariantDescription variant;
    variant.name = variant.label = name;
    ablation.variants.push_back(variant);
  }
  for (const auto& [better, worse] : {std::pair("small", "large"), std::pair("small", "absent")}) {
    ClaimDescription claim;
    claim.name = "claim";
    claim.metric = "error";
    claim.better = better;
    claim.worse = worse;
    ablation.claims.push_back(claim);
  }
  std::vector<VariantNumbers> numbers(2);
  numbers[0].variant = "small";
  numbers[1].variant = "large";
  for (int64_t seed = 0; seed < 3; ++seed) {
    for (int64_t scene = 0; scene < 64; ++scene) {
      const std::string name = std::to_string(scene);
      const double size = 0.01 * static_cast<double>(scene) + 0.001 * static_cast<double>(seed);
      numbers[0].metrics["error"][seed][name][""] = 1 + size;
      numbers[1].metrics["error"][seed][name][""] = 2 + 2 * size;
    }
  }
  const auto results = judge_claims(ablation, numbers);
  ASSERT_EQ(results.size(), 2U);
  EXPECT_EQ(results[0].comparison.verdict, Verdict::kHolds);
  EXPECT_NEAR(results[0].comparison.mean, 1 + 0.01 * 31.5 + 0.001, 1e-12);
  EXPECT_EQ(results[1].comparison.verdict, Verdict::kUndecided);
  EXPECT_EQ(results[1].comparison.reason, "not run: --only left a variant out");
}

}  // namespace
}  // namespace gld
