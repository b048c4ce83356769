#include "infer/page/eval_page.h"

#include "gld/page/results.h"
#include "gld/page/run_report.h"
#include "gld/report/table.h"

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>

namespace gld {
namespace {

// Sheets are large: a page has so many beside the best, median and worst scene.
constexpr size_t kMostSheets = 6;

std::string number_text(const nlohmann::ordered_json& value) {
  return value.is_number() ? short_number(value.get<double>()) : "";
}

ResultTable means_table(const nlohmann::ordered_json& means, const std::string& title) {
  ResultTable table;
  table.title = title;
  table.hint = "Means over scenes, with their 95 % intervals by a bootstrap over scenes.";
  table.columns = {"metric", "mean", "95 % interval", "unit", "better", "scenes", "absent"};
  if (!means.is_object()) return table;
  for (const auto& [name, of_metric] : means.items()) {
    // What no scene has is no number.
    if (!report_value(of_metric, "/mean").is_number()) continue;
    const auto& interval = report_value(of_metric, "/interval_95");
    const std::string low = number_text(report_value(of_metric, "/interval_95/0"));
    int64_t absent = 0;
    for (const auto& count : report_value(of_metric, "/absent")) {
      if (count.is_number_integer()) absent += count.get<int64_t>();
    }
    table.rows.push_back({name, number_text(report_value(of_metric, "/mean")),
                          interval.is_array() && !low.empty()
                              ? low + " to " + number_text(report_value(of_metric, "/interval_95/1"))
                              : "",
                          report_text_at(of_metric, "/unit"), report_text_at(of_metric, "/better"),
                          report_number_at(of_metric, "/scenes"), absent > 0 ? std::to_string(absent) : ""});
  }
  return table;
}

std::string evaluation_verdict(const nlohmann::ordered_json& report) {
  const auto mean = [&](const char* metric) {
    return report_value(report, std::string("/means/") + metric + "/mean");
  };
  const std::string scenes = report_number_at(report, "/scenes");
  const auto sample = mean("sample_psnr");
  if (!sample.is_number()) return scenes + " scenes were evaluated.";
  std::string verdict =
      fmt::format("Over {} scenes the samples have a PSNR of {:.1f} dB", scenes, sample.get<double>());
  const std::pair<const char*, const char*> others[] = {
      {"mean_prediction_psnr", "the mean prediction"},
      {"warped_sources_psnr", "the photographs carried into the views"},
      {"psnr_nearest_source", "the nearest photograph as it is"}};
  std::string list;
  for (const auto& [metric, words] : others) {
    if (const auto value = mean(metric); value.is_number()) {
      list += fmt::format("{}{} {:.1f}", list.empty() ? "; " : ", ", words, value.get<double>());
    }
  }
  verdict += list + ".";
  const std::string better = report_number_at(report, "/better_than_every_trivial");
  if (!better.empty()) {
    verdict +=
        fmt::format(" In {} of {} scenes they are better than every predictor that knows the sources only.",
                    better, scenes);
  }
  return verdict;
}

std::vector<std::pair<std::string, std::string>> sheets_of(const std::filesystem::path& run) {
  std::vector<std::pair<std::string, std::string>> sheets;
  std::error_code error;
  for (const auto& [name, file] :
       {std::pair("best scene", "best_scene.png"), std::pair("median scene", "median_scene.png"),
        std::pair("worst scene", "worst_scene.png")}) {
    if (std::filesystem::is_regular_file(run / file, error)) sheets.emplace_back(name, file);
  }
  std::vector<std::string> names;
  for (const auto& item : std::filesystem::directory_iterator(run / "sheets", error)) {
    if (item.path().extension() == ".png") names.push_back(item.path().filename().string());
  }
  std::sort(names.begin(), names.end());
  if (names.size() > kMostSheets) names.resize(kMostSheets);
  for (const std::string& name : names)
    sheets.emplace_back(name.substr(0, name.size() - 4), "sheets/" + name);
  return sheets;
}

std::vector<std::pair<std::string, std::string>> plots_of(const std::filesystem::path& run) {
  std::vector<std::pair<std::string, std::string>> plots;
  std::error_code error;
  for (const char* name : {"psnr", "ssim", "lpips", "attention_pck"}) {
    const std::string file = std::string("plots/") + name + ".png";
    if (std::filesystem::is_regular_file(run / file, error)) plots.emplace_back(name, file);
  }
  return plots;
}

}  // namespace

Page evaluation_page(const std::filesystem::path& run) {
  const auto report = read_run_report(run);
  const std::string model = std::filesystem::path(report_text_at(report, "/model")).filename().string();
  Page page = results_page("gld eval" + (model.empty() ? "" : ", model " + model), report);
  page.verdict = evaluation_verdict(report);
  add_pictures(page, "Pictures",
               "Sources, then for each target view the truth, the mean prediction and the sample.", run,
               sheets_of(run));
  const auto& by_sources = report_value(report, "/by_sources");
  if (by_sources.is_object()) {
    for (const auto& [sources, summary] : by_sources.items()) {
      add_table(page, means_table(report_value(summary, "/means"), "Metrics with " + sources + " sources"));
    }
  } else {
    add_table(page, means_table(report_value(report, "/means"), "Metrics"));
  }
  add_pictures(page, "Over scenes", "Values of all scenes, sorted.", run, plots_of(run));
  add_fact(page, "Model", model);
  add_fact(page, "SHA-256 of its weights", report_text_at(report, "/model_hash"));
  add_fact(page, "Samples", report_text_at(report, "/methods/sample/method"));
  add_fact(page, "Guidance", report_number_at(report, "/methods/sample/guidance_scale"));
  add_fact(page, "Mean prediction", report_text_at(report, "/methods/mean_prediction/method"));
  add_fact(page, "Precision", report_text_at(report, "/precision"));
  add_fact(page, "Samples a scene", report_number_at(report, "/protocol/samples"));
  add_fact(page, "Poses from", report_text_at(report, "/protocol/poses_from"));
  return page;
}

}  // namespace gld
