#include "ablate/page/ablation_page.h"

#include "ablate/statistics/verdict.h"
#include "gld/page/results.h"
#include "gld/page/run_report.h"
#include "gld/report/table.h"

#include <algorithm>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>

namespace gld {
namespace {

using Json = nlohmann::ordered_json;

std::string number_text(const Json& value) {
  return value.is_number() ? short_number(value.get<double>()) : "";
}

// Returns for example "5.7 [5.2, 6.3]".
std::string with_interval(const Json& row, const std::string& key) {
  const std::string mean = number_text(report_value(row, key));
  const std::string low = number_text(report_value(row, "/interval_95/0"));
  return mean.empty() || low.empty()
             ? mean
             : mean + " [" + low + ", " + number_text(report_value(row, "/interval_95/1")) + "]";
}

// Returns the variants' labels by their names.
std::map<std::string, std::string> labels_of(const Json& report) {
  std::map<std::string, std::string> labels;
  for (const Json& variant : report_value(report, "/variants")) {
    labels[report_text_at(variant, "/name")] = report_text_at(variant, "/label");
  }
  return labels;
}

ResultTable variants_table(const Json& report) {
  ResultTable table;
  table.title = "Variants";
  table.hint =
      "Means over scenes and seeds with 95 % intervals of the hierarchical bootstrap (seeds, then scenes).";
  table.columns = {"variant"};
  std::vector<std::string> metrics;
  const Json& variants = report_value(report, "/variants");
  for (const Json& variant : variants) {
    const Json& values = report_value(variant, "/metrics");
    if (!values.is_object()) continue;
    for (const auto& [metric, value] : values.items()) {
      if (std::find(metrics.begin(), metrics.end(), metric) != metrics.end()) continue;
      metrics.push_back(metric);
      const std::string unit = report_text_at(value, "/unit");
      table.columns.push_back(fmt::format("{}{}{} ({})", metric, unit.empty() ? "" : ", ", unit,
                                          report_text_at(value, "/better")));
    }
  }
  for (const Json& variant : variants) {
    std::vector<std::string> row{report_text_at(variant, "/label")};
    for (const std::string& metric : metrics) {
      const Json& values = report_value(variant, "/metrics");
      const bool has = values.is_object() && values.contains(metric);
      row.push_back(has ? with_interval(values.at(metric), "/mean") : "");
    }
    table.rows.push_back(std::move(row));
  }
  return table;
}

ResultTable claims_table(const Json& report) {
  ResultTable table;
  table.title = "Claims";
  table.hint =
      "Paired by scene, noise and seed; positive where the claim holds; p corrected for the claims of the table.";
  table.columns = {"claim",     "metric",       "better by", "scenes won : lost",
                   "p by Holm", "in the paper", "verdict"};
  const auto labels = labels_of(report);
  const auto label = [&](const std::string& name) {
    const auto found = labels.find(name);
    return found == labels.end() ? name : found->second;
  };
  for (const Json& claim : report_value(report, "/claims")) {
    const std::string reason = report_text_at(claim, "/reason");
    const std::string better = report_text_at(claim, "/better"), worse = report_text_at(claim, "/worse");
    std::string text =
        better.empty() ? report_text_at(claim, "/name") : label(better) + " over " + label(worse);
    const std::string first = report_text_at(claim, "/beyond/0"), second = report_text_at(claim, "/beyond/1");
    if (!first.empty()) text += ", by more than " + label(first) + " over " + label(second);
    const Json scenes = report_value(claim, "/scenes");
    const bool tells_p = scenes.is_number() && scenes.get<int64_t>() >= kFewestTellingScenes;
    table.rows.push_back(
        {text, report_text_at(claim, "/metric"), with_interval(claim, "/better_by"),
         report_number_at(claim, "/scenes_won") + " : " + report_number_at(claim, "/scenes_lost"),
         tells_p ? number_text(report_value(claim, "/holm_p")) : "-", report_text_at(claim, "/paper"),
         report_text_at(claim, "/verdict") + (reason.empty() ? "" : " (" + reason + ")")});
  }
  return table;
}

std::string ablation_verdict(const Json& report) {
  std::map<std::string, int64_t> counts;
  int64_t claims = 0;
  for (const Json& claim : report_value(report, "/claims")) {
    ++claims;
    ++counts[report_text_at(claim, "/verdict")];
  }
  if (claims == 0) return "This ablation compares its variants and makes no claim.";
  std::string list;
  for (const auto& [verdict, count] : counts) {
    list += fmt::format("{}{} {}", list.empty() ? "" : ", ", count,
                        verdict.empty() ? "without a verdict" : verdict);
  }
  return fmt::format("Of {} claim{}: {}.", claims, claims == 1 ? "" : "s", list);
}

}  // namespace

Page ablation_page(const std::filesystem::path& run) {
  const Json report = read_run_report(run);
  const std::string title = report_text_at(report, "/title");
  Page page = results_page(title.empty() ? "gld ablate" : title, report);
  page.verdict = ablation_verdict(report);
  const Json& smoke = report_value(report, "/smoke");
  if (smoke.is_boolean() && smoke.get<bool>()) {
    page.doubts.emplace_back("This is a smoke run, whose stages take seconds: its numbers say nothing.");
  }
  add_table(page, claims_table(report));
  add_table(page, variants_table(report));
  std::error_code error;
  const auto show = [&](const std::string& name, const std::string& title, const std::string& hint) {
    if (std::filesystem::is_regular_file(run / name, error))
      add_pictures(page, title, hint, run, {{name, name}});
  };
  show("claims.png", "What is claimed", "A claim holds above the dotted line, with its 95 % interval.");
  show("ablation.png", "Means and intervals", "");
  for (const Json& stage : report_value(report, "/stages")) {
    if (!report_value(stage, "/stage").is_string()) continue;
    std::string name = report_text_at(stage, "/stage");
    const std::string first = report_text_at(stage, "/used_by/0");
    const Json& used = report_value(stage, "/used_by");
    if (!first.empty()) name += ": " + first;
    if (used.is_array() && used.size() > 1) name += fmt::format(" and {} more", used.size() - 1);
    page.data["stages"].push_back({{"stage", name},
                                   {"seconds", report_value(stage, "/seconds")},
                                   {"peak_bytes", report_value(stage, "/peak_bytes")}});
  }
  add_fact(page, "Description", report_text_at(report, "/description"));
  add_fact(page, "Program", report_text_at(report, "/program"));
  for (const Json& other : report_value(report, "/other_runs")) {
    add_fact(page, "Seeds of another run",
             fmt::format("{} of {} ({})", report_value(other, "/seeds").dump(), report_text_at(other, "/run"),
                         report_text_at(other, "/program")));
  }
  page.data["command"] = report_text_at(report, "/repeat_with");
  return page;
}

}  // namespace gld
