#include "ablate/report/ablation_report.h"

#include "gld/base/command_options.h"
#include "gld/report/progress.h"
#include "gld/report/shell_word.h"
#include "gld/report/table.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {
namespace {

struct Summary {
  double mean = std::numeric_limits<double>::quiet_NaN();
  Interval interval;
  int64_t scenes = 0;
  int64_t seeds = 0;
};

Summary summary_of(const Ablation& ablation, const VariantNumbers& numbers, const std::string& metric) {
  Summary summary;
  const auto found = numbers.metrics.find(metric);
  if (found == numbers.metrics.end()) return summary;
  const NumbersBySeed means = scene_means(found->second);
  BootstrapOptions bootstrap;
  bootstrap.replicates = ablation.options.bootstrap;
  summary.mean = mean_of_seed_means(means);
  summary.interval = test_of_seed_means(means, bootstrap).interval;
  summary.scenes = scene_count(means);
  summary.seeds = static_cast<int64_t>(means.size());
  return summary;
}

// Returns the number with its interval, and with as many digits as that shows.
std::string number_text(double value, const Interval& interval) {
  if (!std::isfinite(value)) return "absent";
  const double width = interval.high - interval.low;
  if (!(width > 0)) return fmt::format("{:.3f}", value);  // of one number, or of equal ones
  const int digits = std::clamp(static_cast<int>(std::ceil(1 - std::log10(width))), 0, 6);
  return fmt::format("{:.{}f} [{:.{}f}, {:.{}f}]", value, digits, interval.low, digits, interval.high,
                     digits);
}

std::string with_unit(const MetricDescription& metric) {
  return metric.name + (metric.unit.empty() ? "" : ", " + metric.unit);
}

std::string label_of(const Ablation& ablation, const std::string& variant) {
  const VariantDescription* found = ablation.variant(variant);
  return found == nullptr ? variant : found->label;
}

std::string p_text(double p, int64_t scenes) { return scenes < kFewestTellingScenes ? "-" : short_number(p); }

// Names metrics whose means are not of the same scenes in every variant, a sentence each: such means must not be
// compared, claims are of the scenes that both have.
std::string unlike_scenes_text(const Ablation& ablation, const AblationResults& results) {
  std::string text;
  for (const MetricDescription& metric : ablation.metrics) {
    std::set<std::set<std::pair<int64_t, std::string>>> kinds;
    std::string counts;
    for (const VariantNumbers& numbers : results.numbers) {
      const auto found = numbers.metrics.find(metric.name);
      if (found == numbers.metrics.end()) continue;
      std::set<std::pair<int64_t, std::string>> scenes;
      for (const auto& [seed, values] : scene_means(found->second)) {
        for (const auto& [scene, value] : values) scenes.emplace(seed, scene);
      }
      counts += fmt::format("{}{} {}", counts.empty() ? "" : ", ", label_of(ablation, numbers.variant),
                            scenes.size());
      kinds.insert(std::move(scenes));
    }
    if (kinds.size() < 2) continue;
    text += fmt::format(
        "\n{} is not known in the same scenes of every variant (scenes of all seeds: {}): its means are not of the "
        "same scenes, what the claims say is.\n",
        metric.name, counts);
  }
  return text;
}

std::string variants_table(const Ablation& ablation, const AblationResults& results) {
  std::vector<std::string> header{"variant"};
  for (const MetricDescription& metric : ablation.metrics) {
    header.push_back(with_unit(metric) + " (" + metric.better + ")");
  }
  header.insert(header.end(), {"scenes", "seeds"});
  Table table(header);
  for (const VariantNumbers& numbers : results.numbers) {
    std::vector<TableCell> row{label_of(ablation, numbers.variant)};
    int64_t scenes = 0;
    int64_t seeds = 0;
    for (const MetricDescription& metric : ablation.metrics) {
      const Summary summary = summary_of(ablation, numbers, metric.name);
      row.emplace_back(number_text(summary.mean, summary.interval));
      scenes = std::max(scenes, summary.scenes);
      seeds = std::max(seeds, summary.seeds);
    }
    row.emplace_back(scenes);
    row.emplace_back(seeds);
    table.add_row(row);
  }
  return table.markdown();
}

std::string claim_text(const Ablation& ablation, const ClaimDescription& claim) {
  const auto over = [&](const std::string& better, const std::string& worse) {
    return label_of(ablation, better) + " over " + label_of(ablation, worse);
  };
  std::string text = over(claim.better, claim.worse);
  if (!claim.beyond.empty()) text += ", by more than " + over(claim.beyond[0], claim.beyond[1]);
  return text;
}

std::string claims_table(const Ablation& ablation, const AblationResults& results) {
  Table table({"claim", "metric", "better by", "scenes won : lost", "sign test p", "p", "p by Holm", "scenes",
               "seeds in favour", "paper", "verdict"});
  for (const ClaimResult& result : results.claims) {
    const Comparison& comparison = result.comparison;
    table.add_row({claim_text(ablation, result.claim), with_unit(ablation.metric(result.claim.metric)),
                   number_text(comparison.mean, comparison.interval),
                   fmt::format("{} : {}", comparison.signs.positive, comparison.signs.negative),
                   short_number(comparison.signs.p_value), p_text(comparison.p_value, comparison.scenes),
                   p_text(comparison.holm_p_value, comparison.scenes), comparison.scenes,
                   fmt::format("{} of {}", comparison.seeds_in_favour, comparison.seeds), result.claim.paper,
                   verdict_name(comparison.verdict, result.claim.paper) +
                       (comparison.reason.empty() ? "" : " (" + comparison.reason + ")")});
  }
  return table.markdown();
}

std::string command_text(const Ablation& ablation) {
  const AblateOptions& options = ablation.options;
  const auto list = [](const auto& values) { return fmt::format("{}", fmt::join(values, ",")); };
  const AblateOptions defaults;
  std::string text = "gld ablate --config " + shell_word(ablation.file.string());
  text += " --out " + shell_word(options.out) + " --model " + shell_word(options.model);
  text += " --seeds " + list(options.seeds);
  if (!options.with_runs.empty()) text += " --with-runs " + shell_word(list(options.with_runs));
  if (!options.cache.empty()) text += " --cache " + shell_word(options.cache);
  if (options.smoke) text += " --smoke";
  if (!options.only.empty()) text += " --only " + shell_word(list(options.only));
  if (!options.overrides.empty()) text += " --overrides " + shell_word(list(options.overrides));
  if (options.bootstrap != defaults.bootstrap) text += fmt::format(" --bootstrap {}", options.bootstrap);
  if (options.threads != defaults.threads) text += fmt::format(" --threads {}", options.threads);
  if (options.device != defaults.device) text += " --device " + options.device;
  return text;
}

nlohmann::ordered_json number_or_nothing(double value) {
  return std::isfinite(value) ? nlohmann::ordered_json(value) : nlohmann::ordered_json();
}

nlohmann::ordered_json interval_json(const Interval& interval) {
  return {number_or_nothing(interval.low), number_or_nothing(interval.high)};
}

std::string other_runs_text(const AblationResults& results) {
  if (results.others.empty()) return "";
  constexpr double kSecondsInAnHour = 3600;
  Table table({"run", "seeds", "program", "hours"});
  for (const OtherRun& other : results.others) {
    table.add_row({other.folder.string(), fmt::format("{}", fmt::join(other.seeds, ", ")), other.program,
                   fmt::format("{:.2f}", other.seconds / kSecondsInAnHour)});
  }
  return "\nSeeds that other runs of the same question measured, whose stages are not listed below:\n\n" +
         table.markdown();
}

}  // namespace

std::string ablation_markdown(const Ablation& ablation, const AblationPlan& plan, const StageCache& cache,
                              const AblationResults& results) {
  std::string text =
      "# " + ablation.title + "\n\n`" + command_text(ablation) + "` (" + results.program + ")\n\n";
  if (ablation.options.smoke) {
    text += "A smoke run: it shows that everything runs. Its figures say nothing.\n\n";
  }
  text +=
      "Means over scenes and seeds with 95 % intervals of the hierarchical bootstrap (seeds, then scenes).\n\n";
  text += variants_table(ablation, results) + unlike_scenes_text(ablation, results);
  if (!results.claims.empty()) {
    text += "\nClaims, paired by scene, noise and seed; positive where the claim holds:\n\n" +
            claims_table(ablation, results);
  }
  std::string problems;
  for (const VariantNumbers& numbers : results.numbers) {
    for (const std::string& problem : numbers.problems) {
      problems += "- " + label_of(ablation, numbers.variant) + ": " + problem + "\n";
    }
  }
  if (!problems.empty()) text += "\nNot everything ran:\n\n" + problems;
  text += other_runs_text(results);
  Table stages({"stage", "used by", "seconds", "memory, MB", "disk, MB", "cache"});
  for (const StageTask& task : plan.tasks) {
    const auto cost = cache.cost(task);
    const std::string users =
        task.used_by.front() +
        (task.used_by.size() > 1 ? fmt::format(" and {} more", task.used_by.size() - 1) : "");
    if (!cost) {
      stages.add_row({task.stage, users, "not done", "", "", task.key});
      continue;
    }
    stages.add_row(
        {task.stage, users, fmt::format("{:.1f}", cost->seconds),
         cost->peak_bytes > 0 ? fmt::format("{:.0f}", static_cast<double>(cost->peak_bytes) / 1e6) : "",
         fmt::format("{:.1f}", static_cast<double>(cost->disk_bytes) / 1e6), task.key});
  }
  return text + "\nStages (" + std::to_string(ablation.options.threads) + " threads each, up to " +
         std::to_string(ablation.options.jobs_to_use()) + " at a time):\n\n" + stages.markdown();
}

std::string ablation_csv(const AblationResults& results) {
  Table table({"variant", "seed", "scene", "target", "metric", "value"});
  for (const VariantNumbers& numbers : results.numbers) {
    for (const auto& [metric, measured] : numbers.metrics) {
      for (const auto& [seed, scenes] : measured) {
        for (const auto& [scene, views] : scenes) {
          for (const auto& [view, value] : views)
            table.add_row({numbers.variant, seed, scene, view, metric, value});
        }
      }
    }
  }
  return table.csv();
}

nlohmann::ordered_json ablation_json(const Ablation& ablation, const AblationPlan& plan,
                                     const StageCache& cache, const AblationResults& results) {
  nlohmann::ordered_json json{{"command", "ablate"},
                              {"title", ablation.title},
                              {"description", ablation.file.string()},
                              {"program", results.program},
                              {"repeat_with", command_text(ablation)},
                              {"smoke", ablation.options.smoke},
                              {"seeds", ablation.options.seeds}};
  json["reads"] = numbers_read(ablation, plan);
  for (const OtherRun& other : results.others) {
    json["other_runs"].push_back({{"run", other.folder.string()},
                                  {"seeds", other.seeds},
                                  {"program", other.program},
                                  {"seconds", other.seconds}});
  }
  for (const VariantNumbers& numbers : results.numbers) {
    nlohmann::ordered_json variant{{"name", numbers.variant}, {"label", label_of(ablation, numbers.variant)}};
    for (const MetricDescription& metric : ablation.metrics) {
      const Summary summary = summary_of(ablation, numbers, metric.name);
      variant["metrics"][metric.name] = {{"mean", number_or_nothing(summary.mean)},
                                         {"interval_95", interval_json(summary.interval)},
                                         {"scenes", summary.scenes},
                                         {"seeds", summary.seeds},
                                         {"unit", metric.unit},
                                         {"better", metric.better}};
    }
    if (!numbers.problems.empty()) variant["problems"] = numbers.problems;
    json["variants"].push_back(std::move(variant));
  }
  json["claims"] = nlohmann::ordered_json::array();
  for (const ClaimResult& result : results.claims) {
    const Comparison& comparison = result.comparison;
    nlohmann::ordered_json claim{{"name", result.claim.name},
                                 {"metric", result.claim.metric},
                                 {"better", result.claim.better},
                                 {"worse", result.claim.worse},
                                 {"paper", result.claim.paper},
                                 {"better_by", number_or_nothing(comparison.mean)},
                                 {"interval_95", interval_json(comparison.interval)},
                                 {"scenes_won", comparison.signs.positive},
                                 {"scenes_lost", comparison.signs.negative},
                                 {"scenes_tied", comparison.signs.ties},
                                 {"sign_test_p", comparison.signs.p_value},
                                 {"p", comparison.p_value},
                                 {"holm_p", comparison.holm_p_value},
                                 {"scenes", comparison.scenes},
                                 {"seeds", comparison.seeds},
                                 {"seeds_in_favour", comparison.seeds_in_favour},
                                 {"verdict", verdict_name(comparison.verdict, result.claim.paper)}};
    if (!result.claim.beyond.empty()) claim["beyond"] = result.claim.beyond;
    if (!comparison.reason.empty()) claim["reason"] = comparison.reason;
    json["claims"].push_back(std::move(claim));
  }
  for (const StageTask& task : plan.tasks) {
    nlohmann::ordered_json stage{{"stage", task.stage},
                                 {"command", task.command},
                                 {"cache", task.key},
                                 {"question", task.question},
                                 {"used_by", task.used_by}};
    if (const auto cost = cache.cost(task)) {
      stage["seconds"] = cost->seconds;
      stage["peak_bytes"] = cost->peak_bytes;
      stage["disk_bytes"] = cost->disk_bytes;
    }
    json["stages"].push_back(std::move(stage));
  }
  return json;
}

Figure ablation_figure(const Ablation& ablation, const AblationResults& results) {
  const bool curves = std::any_of(ablation.variants.begin(), ablation.variants.end(),
                                  [](const VariantDescription& variant) { return !variant.series.empty(); });
  Figure figure;
  figure.title = ablation.title;
  figure.panel_width = 420;
  for (const MetricDescription& metric : ablation.metrics) {
    PlotPanel panel;
    panel.title = metric.name;
    panel.y.label = with_unit(metric);
    panel.x.label = curves ? "" : "variant";
    if (!curves) {
      panel.x.low = 0.5;
      panel.x.high = 0.5 + static_cast<double>(ablation.variants.size());
    }
    double place = 0;
    for (const VariantDescription& variant : ablation.variants) {
      place += 1;
      const auto numbers =
          std::find_if(results.numbers.begin(), results.numbers.end(),
                       [&](const VariantNumbers& one) { return one.variant == variant.name; });
      const Summary summary = summary_of(ablation, *numbers, metric.name);
      if (!std::isfinite(summary.mean)) continue;
      if (!curves) {
        // This line joins the ends of the interval and the mean.
        panel.series.push_back(
            {variant.label,
             SeriesStyle::kLine,
             {{place, summary.interval.low}, {place, summary.mean}, {place, summary.interval.high}}});
        continue;
      }
      const std::string name = variant.series.empty() ? variant.label : variant.series;
      auto line = std::find_if(panel.series.begin(), panel.series.end(),
                               [&](const PlotSeries& series) { return series.name == name; });
      if (line == panel.series.end()) line = panel.series.insert(line, {name, SeriesStyle::kLine, {}});
      line->points.emplace_back(variant.x, summary.mean);
    }
    if (!panel.series.empty()) figure.panels.push_back(std::move(panel));
  }
  return figure;
}

Figure claims_figure(const Ablation& ablation, const AblationResults& results) {
  Figure figure;
  figure.title = ablation.title + ": what is claimed";
  figure.panel_width = 420;
  for (const MetricDescription& metric : ablation.metrics) {
    PlotPanel panel;
    panel.title = metric.name;
    panel.y.label = "better by" + (metric.unit.empty() ? "" : ", " + metric.unit);
    panel.x.label = "claim";
    double place = 0;
    for (const ClaimResult& result : results.claims) {
      const Comparison& comparison = result.comparison;
      if (result.claim.metric != metric.name || !std::isfinite(comparison.mean)) continue;
      place += 1;
      panel.series.push_back(
          {claim_text(ablation, result.claim),
           SeriesStyle::kLine,
           {{place, comparison.interval.low}, {place, comparison.mean}, {place, comparison.interval.high}}});
    }
    if (panel.series.empty()) continue;
    panel.x.low = 0.5;
    panel.x.high = 0.5 + place;
    panel.series.push_back({"no difference", SeriesStyle::kLevel, {{panel.x.low, 0}, {panel.x.high, 0}}});
    figure.panels.push_back(std::move(panel));
  }
  return figure;
}

}  // namespace gld
