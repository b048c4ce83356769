#pragma once

#include "ablate/statistics/paired_statistics.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

enum class Verdict {
  kHolds,     // the difference is what was claimed
  kOpposite,  // it has the other sign
  kUndecided,
};
// "reproduced" of what a paper reports (that text is not empty), "supported" of a claim of our own.
std::string verdict_name(Verdict verdict, const std::string& paper);

// What the seeds of a table are of: noise of evaluations, or trainings too, which differ by more.
enum class SeedsOf { kEvaluations, kTrainings };

// A verdict needs at least these. Two trainings say nothing of how much trainings differ.
constexpr int64_t kFewestVerdictScenes = 64;
int64_t fewest_verdict_seeds(SeedsOf seeds);  // 2, 3
// Of fewer scenes the bootstrap draws the same ones again and again, and its p-value says nothing: it counts as 1.
constexpr int64_t kFewestTellingScenes = 8;
// Holm's p-value of a claim has to be below this: of twenty tables in which nothing is so, about one decides something.
constexpr double kVerdictLevel = 0.05;

// Returns how many times as much has to be measured until a p-value of p is needed_p, if the mean stays as it is: its
// deviation falls with the root of that. It holds for normal means and two-sided p-values; it is infinite for p = 1.
double times_as_much(double p, double needed_p);

// A paired comparison of two variants: positive differences speak for the one that is claimed to be better.
struct Comparison {
  double mean = 0;  // of the differences; NaN where there are none
  Interval interval;
  double p_value =
      1;  // of "no difference": of the replicates, of trainings no smaller than that of their means
  double holm_p_value = 1;  // corrected for the claims that were judged together
  SignTest signs;
  int64_t scenes = 0;
  int64_t seeds = 0;
  int64_t seeds_in_favour = 0;   // whose mean difference is positive
  int64_t seeds_against = 0;     // whose is negative
  double seeds_p_value = 1;      // seed_means_p_value()
  bool seeds_are_equal = false;  // not one number depends on the seed
  Verdict verdict = Verdict::kUndecided;
  std::string reason;  // of an undecided one: one phrase
};

// gain is by how much the claimed one is better, for each seed and scene. Everything but holm_p_value, verdict and
// reason is filled in.
Comparison compare(const NumbersBySeed& gain, const BootstrapOptions& options = {});

// Gives the verdicts of claims that are made together, those of one table. A claim holds (or the opposite does) where
// the 95 % interval lies above (below) 0, Holm's p-value over all of them is below kVerdictLevel, and the mean of every
// seed has that sign too; it is undecided, with the reason, where that is not so, and whatever the interval is with
// fewer scenes than kFewestVerdictScenes or fewer seeds than fewest_verdict_seeds(). Seeds that gave the same numbers
// count as one. A claim that has a reason already keeps it and is undecided; it counts among all, so that leaving some
// out makes no other one easier.
void judge(std::vector<Comparison>& claims, SeedsOf seeds);

}  // namespace gld
