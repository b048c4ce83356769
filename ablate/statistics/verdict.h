#pragma once

#include "ablate/statistics/paired_statistics.h"

#include <cstdint>
#include <string>

namespace gld {

enum class Verdict {
  kReproduced,  // the difference is what was claimed
  kOpposite,    // it has the other sign
  kUndecided,
};
std::string verdict_name(Verdict verdict);  // "reproduced"

// What a verdict needs at least.
constexpr int64_t kFewestVerdictScenes = 64;
constexpr int64_t kFewestVerdictSeeds = 2;

// A paired comparison of two variants: positive differences speak for the one that is claimed to be better.
struct Comparison {
  double mean = 0;  // of the differences; NaN where there are none
  Interval interval;
  SignTest signs;
  int64_t scenes = 0;
  int64_t seeds = 0;
  int64_t seeds_in_favour = 0;  // whose mean difference is positive
  Verdict verdict = Verdict::kUndecided;
  std::string reason;  // of an undecided one: one phrase
};

// gain: by how much the claimed one is better, for each seed and scene. Reproduced (or opposite) where the 95 %
// interval lies above (below) 0 and the mean of every seed too; undecided, with the reason, where it does not, and
// whatever the interval with fewer scenes or seeds than a verdict needs. Seeds that gave the same numbers count as one.
Comparison compare(const NumbersBySeed& gain, const BootstrapOptions& options = {});

}  // namespace gld
