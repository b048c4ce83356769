#include "ablate/report/comparisons.h"

#include "ablate/report/result_rows.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

namespace gld {
namespace {

const VariantNumbers& numbers_of(const std::vector<VariantNumbers>& numbers, const std::string& variant) {
  return *std::find_if(numbers.begin(), numbers.end(),
                       [&](const VariantNumbers& one) { return one.variant == variant; });
}

// Each run of a stage that is repeated has scenes of its own, whatever they are called.
std::string scene_of_run(const VariantRun& run, size_t repeat, const std::string& scene) {
  return run.results.size() == 1 ? scene : fmt::format("{}, run {}", scene, repeat);
}

}  // namespace

std::string column_of(const VariantDescription& variant, const MetricDescription& metric) {
  const auto own = variant.columns.find(metric.name);
  return own == variant.columns.end() ? metric.column : own->second;
}

std::vector<VariantNumbers> collect_numbers(const Ablation& ablation, const AblationPlan& plan,
                                            const StageCache& cache,
                                            const std::vector<TaskOutcome>& outcomes) {
  std::vector<VariantNumbers> all;
  for (size_t number = 0; number < ablation.variants.size(); ++number) {
    const VariantDescription& variant = ablation.variants[number];
    VariantNumbers numbers;
    numbers.variant = variant.name;
    for (const VariantRun& run : plan.runs) {
      if (run.variant != number) continue;
      for (size_t repeat = 0; repeat < run.results.size(); ++repeat) {
        const size_t result = run.results[repeat];
        const StageTask& task = plan.tasks[result];
        if (!outcomes[result].done) {
          const std::string problem = outcomes[result].problem;
          if (std::find(numbers.problems.begin(), numbers.problems.end(), problem) ==
              numbers.problems.end()) {
            numbers.problems.push_back(problem);
          }
          continue;
        }
        const ResultRows rows = read_result_rows(cache.run(task) / ablation.stage(task.stage).results);
        for (const MetricDescription& metric : ablation.metrics) {
          const auto found = numbers_by_scene(rows, column_of(variant, metric), variant.rows);
          auto& scenes = numbers.metrics[metric.name][run.seed];
          for (const auto& [scene, views] : found) scenes[scene_of_run(run, repeat, scene)] = views;
        }
      }
    }
    all.push_back(std::move(numbers));
  }
  return all;
}

void check_result_columns(const Ablation& ablation, const AblationPlan& plan, const StageCache& cache,
                          size_t task) {
  for (const VariantRun& run : plan.runs) {
    if (std::find(run.results.begin(), run.results.end(), task) == run.results.end()) continue;
    const VariantDescription& variant = ablation.variants[run.variant];
    const StageTask& stage = plan.tasks[task];
    const ResultRows rows = read_result_rows(cache.run(stage) / ablation.stage(stage.stage).results);
    const auto require_column = [&](const std::string& column, const std::string& what) {
      if (has_column(rows, column)) return;
      const auto near = nearest_name(column, rows.columns);
      fail({fmt::format("{}, {} of variant '{}'", ablation.file.string(), what, variant.name),
            fmt::format("a column of {}", rows.file.string()), "'" + column + "'",
            near.empty() ? "choose one of its first line" : "did you mean '" + near + "'?"});
    };
    for (const auto& [column, text] : variant.rows) require_column(column, "rows");
    for (const MetricDescription& metric : ablation.metrics) {
      const std::string column = column_of(variant, metric);
      require_column(column, "metric '" + metric.name + "'");
      try {
        numbers_by_scene(rows, column, variant.rows);  // refuses rows that are not there
      } catch (const Error& error) {
        const ErrorParts& parts = error.parts();
        fail({fmt::format("{}, variant '{}': {}", ablation.file.string(), variant.name, parts.where),
              parts.expected, parts.found, parts.remedy});
      }
    }
  }
}

NumbersBySeed scene_means(const MeasuredNumbers& numbers) {
  NumbersBySeed means;
  for (const auto& [seed, scenes] : numbers) {
    for (const auto& [scene, views] : scenes) {
      double sum = 0;
      int64_t count = 0;
      for (const auto& [view, value] : views) {
        if (!std::isfinite(value)) continue;
        sum += value;
        ++count;
      }
      if (count > 0) means[seed][scene] = sum / static_cast<double>(count);
    }
  }
  return means;
}

NumbersBySeed paired_gain(Better better, const MeasuredNumbers& first, const MeasuredNumbers& second) {
  MeasuredNumbers gains;
  for (const auto& [seed, scenes] : first) {
    const auto others = second.find(seed);
    if (others == second.end()) continue;
    for (const auto& [scene, views] : scenes) {
      const auto other_views = others->second.find(scene);
      if (other_views == others->second.end()) continue;
      for (const auto& [view, value] : views) {
        const auto other = other_views->second.find(view);
        // Two perfect predictions are equal, and their difference is no number.
        if (other != other_views->second.end()) gains[seed][scene][view] = gain(better, value, other->second);
      }
    }
  }
  return scene_means(gains);
}

NumbersBySeed gain_beyond(const NumbersBySeed& gain, const NumbersBySeed& other) {
  NumbersBySeed above;
  for (const auto& [seed, scenes] : gain) {
    const auto others = other.find(seed);
    if (others == other.end()) continue;
    for (const auto& [scene, value] : scenes) {
      const auto found = others->second.find(scene);
      if (found != others->second.end()) above[seed][scene] = value - found->second;
    }
  }
  return above;
}

std::vector<ClaimResult> judge_claims(const Ablation& ablation, const std::vector<VariantNumbers>& numbers) {
  BootstrapOptions bootstrap;
  bootstrap.replicates = ablation.options.bootstrap;
  std::vector<ClaimResult> results;
  for (const ClaimDescription& claim : ablation.claims) {
    ClaimResult result{claim, {}};
    std::vector<std::string> compared{claim.better, claim.worse};
    compared.insert(compared.end(), claim.beyond.begin(), claim.beyond.end());
    if (std::any_of(compared.begin(), compared.end(),
                    [&](const std::string& variant) { return ablation.variant(variant) == nullptr; })) {
      result.comparison.mean = std::numeric_limits<double>::quiet_NaN();
      result.comparison.reason = "not run: --only left a variant out";
    } else {
      const auto measured = [&](const std::string& variant) {
        const auto& metrics = numbers_of(numbers, variant).metrics;
        const auto found = metrics.find(claim.metric);
        return found == metrics.end() ? MeasuredNumbers() : found->second;
      };
      const Better better = ablation.metric(claim.metric).direction();
      NumbersBySeed gain = paired_gain(better, measured(claim.better), measured(claim.worse));
      if (!claim.beyond.empty()) {
        gain = gain_beyond(gain, paired_gain(better, measured(claim.beyond[0]), measured(claim.beyond[1])));
      }
      result.comparison = compare(gain, bootstrap);
    }
    results.push_back(std::move(result));
  }
  const bool anything_is_trained =
      std::any_of(ablation.stages.begin(), ablation.stages.end(),
                  [](const StageDescription& stage) { return trains(stage.command); });
  std::vector<Comparison> comparisons;
  comparisons.reserve(results.size());
  for (const ClaimResult& result : results) comparisons.push_back(result.comparison);
  judge(comparisons, anything_is_trained ? SeedsOf::kTrainings : SeedsOf::kEvaluations);
  for (size_t i = 0; i < results.size(); ++i) results[i].comparison = std::move(comparisons[i]);
  return results;
}

}  // namespace gld
