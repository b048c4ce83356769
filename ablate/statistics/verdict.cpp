#include "ablate/statistics/verdict.h"

#include <algorithm>
#include <array>

#include <fmt/format.h>

namespace gld {

namespace {

// Whether what was measured does not depend on the seed at all.
bool all_equal(const NumbersBySeed& numbers) {
  return std::all_of(numbers.begin(), numbers.end(),
                     [&](const auto& seed) { return seed.second == numbers.begin()->second; });
}

}  // namespace

std::string verdict_name(Verdict verdict) {
  static const std::array<std::string, 3> names{"reproduced", "opposite", "undecided"};
  return names.at(static_cast<size_t>(verdict));
}

Comparison compare(const NumbersBySeed& gain, const BootstrapOptions& options) {
  Comparison result;
  result.mean = mean_of_seed_means(gain);
  result.interval = interval_of_seed_means(gain, options);
  result.signs = sign_test(gain);
  result.scenes = scene_count(gain);
  result.seeds = static_cast<int64_t>(gain.size());
  int64_t against = 0;
  for (const auto& [seed, values] : gain) {
    const double mean = mean_of_seed_means({{seed, values}});
    if (mean > 0) ++result.seeds_in_favour;
    if (mean < 0) ++against;
  }
  if (result.scenes < kFewestVerdictScenes) {
    result.reason = fmt::format("{} scene{}, a verdict needs {}", result.scenes,
                                result.scenes == 1 ? "" : "s", kFewestVerdictScenes);
  } else if (result.seeds < kFewestVerdictSeeds) {
    result.reason = "one seed, a verdict needs " + std::to_string(kFewestVerdictSeeds);
  } else if (all_equal(gain)) {
    result.reason = "all seeds gave the same numbers, which counts as one seed";
  } else if (!(result.interval.low > 0) && !(result.interval.high < 0)) {
    result.reason = "the interval contains 0";
  } else if (result.interval.low > 0 && result.seeds_in_favour == result.seeds) {
    result.verdict = Verdict::kReproduced;
  } else if (result.interval.high < 0 && against == result.seeds) {
    result.verdict = Verdict::kOpposite;
  } else {
    result.reason =
        fmt::format("the seeds disagree: {} of {} in favour", result.seeds_in_favour, result.seeds);
  }
  return result;
}

}  // namespace gld
