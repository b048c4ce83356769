#include "ablate/statistics/verdict.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

namespace gld {

namespace {

// Returns whether what was measured does not depend on the seed at all.
bool all_equal(const NumbersBySeed& numbers) {
  return std::all_of(numbers.begin(), numbers.end(),
                     [&](const auto& seed) { return seed.second == numbers.begin()->second; });
}

// Returns the deviations from 0 of a normal number with that two-sided p-value.
double deviations_of(double p) {
  double low = 0, high = 40;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (std::erfc(middle / std::sqrt(2.0)) > p ? low : high) = middle;
  }
  return low;
}

// Returns what would decide an undecided claim among those of these p-values. Holm multiplies each by how many are not
// smaller, and goes up to the first that fails: all that are smaller have to pass as well.
std::string what_would_decide(double p, const std::vector<double>& p_values) {
  constexpr double kMost = 1000;
  double times = 0;
  for (const double before : p_values) {
    if (before > p) continue;
    const auto factor =
        std::count_if(p_values.begin(), p_values.end(), [&](double other) { return other >= before; });
    times = std::max(times, times_as_much(before, kVerdictLevel / static_cast<double>(factor)));
  }
  const std::string number = !(times < kMost) ? fmt::format("more than {:.0f}", kMost)
                             : times < 10     ? fmt::format("about {:.1f}", std::max(times, 1.1))
                                              : fmt::format("about {:.0f}", times);
  return fmt::format("; {} times as many scenes and seeds would decide, if the mean stays", number);
}

void judge_one(Comparison& claim, int64_t fewest_seeds, const std::vector<double>& p_values) {
  if (claim.scenes < kFewestVerdictScenes) {
    claim.reason = fmt::format("{} scene{}, a verdict needs {}", claim.scenes, claim.scenes == 1 ? "" : "s",
                               kFewestVerdictScenes);
  } else if (claim.seeds < fewest_seeds) {
    claim.reason =
        fmt::format("{} seed{}, a verdict needs {}", claim.seeds, claim.seeds == 1 ? "" : "s", fewest_seeds);
  } else if (claim.seeds_are_equal) {
    claim.reason = "all seeds gave the same numbers, which counts as one seed";
  } else if (!(claim.interval.low > 0) && !(claim.interval.high < 0)) {
    claim.reason = "the interval contains 0" + what_would_decide(claim.p_value, p_values);
  } else if (!(claim.holm_p_value < kVerdictLevel)) {
    claim.reason =
        claim.p_value < kVerdictLevel
            ? fmt::format(
                  "clear of 0 alone, not among {} claims: p {:.2g}, by Holm {:.2g}, a verdict needs "
                  "less than {}",
                  p_values.size(), claim.p_value, claim.holm_p_value, kVerdictLevel)
            : fmt::format("p {:.2g}, a verdict needs less than {}", claim.p_value, kVerdictLevel);
    claim.reason += what_would_decide(claim.p_value, p_values);
  } else if (claim.interval.low > 0 && claim.seeds_in_favour == claim.seeds) {
    claim.verdict = Verdict::kHolds;
  } else if (claim.interval.high < 0 && claim.seeds_against == claim.seeds) {
    claim.verdict = Verdict::kOpposite;
  } else {
    claim.reason = fmt::format("the seeds disagree: {} of {} in favour", claim.seeds_in_favour, claim.seeds);
  }
}

}  // namespace

double times_as_much(double p, double needed_p) {
  const double ratio = deviations_of(needed_p) / deviations_of(p);
  return ratio * ratio;
}

std::string verdict_name(Verdict verdict, const std::string& paper) {
  switch (verdict) {
    case Verdict::kHolds:
      return paper.empty() ? "supported" : "reproduced";
    case Verdict::kOpposite:
      return "opposite";
    case Verdict::kUndecided:
      break;
  }
  return "undecided";
}

Comparison compare(const NumbersBySeed& gain, const BootstrapOptions& options) {
  Comparison result;
  result.mean = mean_of_seed_means(gain);
  const BootstrapTest test = test_of_seed_means(gain, options);
  result.interval = test.interval;
  result.p_value = test.p_value;
  result.signs = sign_test(gain);
  result.scenes = scene_count(gain);
  result.seeds = static_cast<int64_t>(gain.size());
  for (const auto& [seed, values] : gain) {
    const double mean = mean_of_seed_means({{seed, values}});
    if (mean > 0) ++result.seeds_in_favour;
    if (mean < 0) ++result.seeds_against;
  }
  result.seeds_p_value = seed_means_p_value(gain);
  result.seeds_are_equal = all_equal(gain);
  return result;
}

int64_t fewest_verdict_seeds(SeedsOf seeds) { return seeds == SeedsOf::kTrainings ? 3 : 2; }

void judge(std::vector<Comparison>& claims, SeedsOf seeds) {
  std::vector<double> p_values;
  p_values.reserve(claims.size());
  for (Comparison& claim : claims) {
    if (seeds == SeedsOf::kTrainings) claim.p_value = std::max(claim.p_value, claim.seeds_p_value);
    if (claim.scenes < kFewestTellingScenes) claim.p_value = 1;
    p_values.push_back(claim.p_value);
  }
  const std::vector<double> corrected = holm_p_values(p_values);
  for (size_t i = 0; i < claims.size(); ++i) {
    claims[i].holm_p_value = corrected[i];
    if (claims[i].reason.empty()) judge_one(claims[i], fewest_verdict_seeds(seeds), p_values);
  }
}

}  // namespace gld
