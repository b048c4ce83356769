#include "ablate/report/comparisons.h"

#include <cmath>
#include <limits>
#include <string>
#include <utility>
#include <vector>

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

Ablation ablation_of(const std::string& metric, const std::string& better,
                     const std::vector<std::string>& variants) {
  Ablation ablation;
  ablation.options.bootstrap = 200;
  MetricDescription described;
  described.name = described.column = metric;
  described.better = better;
  ablation.metrics.push_back(described);
  for (const std::string& name : variants) {
    VariantDescription variant;
    variant.name = variant.label = name;
    ablation.variants.push_back(variant);
  }
  return ablation;
}

TEST(JudgeClaims, JudgesByTheMetricsDirectionAndSaysWhatWasNotRun) {
  Ablation ablation = ablation_of("error", "lower", {"small", "large"});
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

// A margin that grows: better by 3 with one source and by 1 with two, in every scene, so by 2 more.
TEST(JudgeClaims, AMarginBeyondAnotherIsTheDifferenceOfBothInTheSameScenes) {
  Ablation ablation = ablation_of("psnr", "higher", {"one", "rival_one", "two", "rival_two"});
  std::vector<VariantNumbers> numbers;
  for (const auto& [name, margin] :
       {std::pair("one", 3.0), {"rival_one", 0.0}, {"two", 1.0}, {"rival_two", 0.0}}) {
    VariantNumbers measured;
    measured.variant = name;
    for (int64_t seed = 0; seed < 3; ++seed) {
      for (int64_t scene = 0; scene < 64; ++scene) {
        // Scenes are of different difficulty, which is in both of a margin and goes with it.
        measured.metrics["psnr"][seed][std::to_string(scene)][""] =
            20 + 0.1 * static_cast<double>(scene) + margin;
      }
    }
    numbers.push_back(measured);
  }
  numbers[2].metrics["psnr"][0].erase("0");  // a scene that one of the four lacks does not count
  ClaimDescription claim;
  claim.metric = "psnr";
  claim.better = "one";
  claim.worse = "rival_one";
  claim.beyond = {"two", "rival_two"};
  ablation.claims.push_back(claim);
  std::swap(claim.better, claim.beyond[0]);
  std::swap(claim.worse, claim.beyond[1]);
  ablation.claims.push_back(claim);
  claim.beyond[1] = "absent";
  ablation.claims.push_back(claim);
  const auto results = judge_claims(ablation, numbers);
  ASSERT_EQ(results.size(), 3U);
  EXPECT_NEAR(results[0].comparison.mean, 2, 1e-12);
  EXPECT_EQ(results[0].comparison.signs.positive, 64);
  EXPECT_NEAR(results[1].comparison.mean, -2, 1e-12);
  EXPECT_EQ(results[2].comparison.reason, "not run: --only left a variant out");
}

}  // namespace
}  // namespace gld
