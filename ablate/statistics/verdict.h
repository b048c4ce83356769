#pragma once

#include "ablate/statistics/paired_statistics.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

enum class Verdict {
  kReproduced,  // the difference is what was claimed
  kOpposite,    // it has the other sign
  kUndecided,
};
std::string verdict_name(Verdict verdict);  // "reproduced"

// What a verdict needs at least. Trainings differ by more than the noise of evaluations, and two of them say nothing of
// how much.
constexpr int64_t kFewestVerdictScenes = 64;
constexpr int64_t kFewestSeedsOfEvaluations = 2;
constexpr int64_t kFewestSeedsOfTrainings = 3;
// What Holm's p-value of a claim has to be below, so that of all claims of a table together none is decided wrongly in
// 95 of 100 tables.
constexpr double kVerdictLevel = 0.05;

// A paired comparison of two variants: positive differences speak for the one that is claimed to be better.
struct Comparison {
  double mean = 0;  // of the differences; NaN where there are none
  Interval interval;
  double p_value = 1;       // of "no difference", by the replicates of the interval
  double holm_p_value = 1;  // corrected for the claims that were judged together
  SignTest signs;
  int64_t scenes = 0;
  int64_t seeds = 0;
  int64_t seeds_in_favour = 0;   // whose mean difference is positive
  int64_t seeds_against = 0;     // whose is negative
  bool seeds_are_equal = false;  // not one number depends on the seed
  Verdict verdict = Verdict::kUndecided;
  std::string reason;  // of an undecided one: one phrase
};

// gain: by how much the claimed one is better, for each seed and scene. Everything but holm_p_value, verdict and
// reason.
Comparison compare(const NumbersBySeed& gain, const BootstrapOptions& options = {});

// The verdicts of claims that are made together, `claims` of one table. Reproduced (or opposite) where the 95 %
// interval lies above (below) 0, Holm's p-value over all claims that have scenes is below kVerdictLevel, and the mean
// of every seed has that sign too; undecided, with the reason, where it is not, and whatever the interval with fewer
// scenes than kFewestVerdictScenes or fewer seeds than `fewest_seeds`. Seeds that gave the same numbers count as one.
// A claim that has a reason already keeps it and is undecided.
void judge(std::vector<Comparison>& claims, int64_t fewest_seeds);

}  // namespace gld
