#pragma once

#include "ablate/configuration/ablation.h"
#include "ablate/plan/stage_cache.h"
#include "ablate/plan/stage_plan.h"
#include "ablate/run/stage_runner.h"
#include "ablate/statistics/verdict.h"

#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace gld {

// A metric of all that was measured of one variant: by seed, scene and target view ("" where rows are whole scenes).
using MeasuredNumbers = std::map<int64_t, std::map<std::string, std::map<std::string, double>>>;

struct VariantNumbers {
  std::string variant;
  std::map<std::string, MeasuredNumbers> metrics;  // by name; empty ones are absent
  std::vector<std::string> problems;               // why seeds are missing
};

// Returns the column of a result's rows that a metric of this variant is.
std::string column_of(const VariantDescription& variant, const MetricDescription& metric);

// Reads the rows of every run that is done.
std::vector<VariantNumbers> collect_numbers(const Ablation& ablation, const AblationPlan& plan,
                                            const StageCache& cache,
                                            const std::vector<TaskOutcome>& outcomes);

// Throws Error, naming the metric, where what this finished task wrote has not the columns that variants are compared
// by: that is known as soon as one is done, and not after hours of the others.
void check_result_columns(const Ablation& ablation, const AblationPlan& plan, const StageCache& cache,
                          size_t task);

// Returns finite numbers averaged over each scene's views.
NumbersBySeed scene_means(const MeasuredNumbers& numbers);

// Returns by how much the first is better, of scenes and views that both have, averaged over each scene's views:
// variants with more target views than others are compared on those that both were asked for.
NumbersBySeed paired_gain(Better better, const MeasuredNumbers& first, const MeasuredNumbers& second);

// Returns by how much one gain is above another, of scenes that both have.
NumbersBySeed gain_beyond(const NumbersBySeed& gain, const NumbersBySeed& other);

struct ClaimResult {
  ClaimDescription claim;
  Comparison comparison;
};

// Returns the claims whose variants ran, judged together; every other one is undecided and says so.
std::vector<ClaimResult> judge_claims(const Ablation& ablation, const std::vector<VariantNumbers>& numbers);

}  // namespace gld
