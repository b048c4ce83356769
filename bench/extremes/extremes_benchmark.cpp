#include "bench/extremes/extremes_benchmark.h"

#include "bench/support/benchmark_report.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/report/run_folder.h"

#include <chrono>
#include <utility>

#include <ATen/core/grad_mode.h>

#include <fmt/format.h>

namespace gld {

void ExtremesBenchmarkOptions::visit(FieldVisitor& visitor) {
  visit_out(visitor, out, overwrite);
  visitor.integer({"camera_sets", "random extreme camera sets to try"}, camera_sets, {0, 10000000});
}

void ExtremesBenchmarkOptions::check() const { check_out(out, "runs/bench"); }

double accepted(const std::function<void()>& action) {
  try {
    action();
  } catch (const Error&) {
    return 0;
  }
  return 1;
}

std::string extreme_text(const ExtremeRow& row) {
  return fmt::format("{}, {}: {} is {:g}, expected at most {:g}.", row.area, row.situation, row.measured,
                     row.value, row.limit);
}

Table extremes_table(const std::vector<ExtremeRow>& rows) {
  Table table({"area", "situation", "measured", "value", "limit", "passed"});
  for (const auto& row : rows) {
    table.add_row({row.area, row.situation, row.measured, row.value, row.limit,
                   std::string(row.passed() ? "yes" : "NO")});
  }
  return table;
}

const std::vector<ExtremeArea>& extreme_areas() {
  static const std::vector<ExtremeArea> areas{
      {"cameras", [](const ExtremeSettings& settings) { return camera_extremes(settings.camera_sets); }},
      {"attention", [](const ExtremeSettings&) { return attention_extremes(); }},
      {"norms", [](const ExtremeSettings&) { return norm_extremes(); }},
      {"flow", [](const ExtremeSettings&) { return flow_extremes(); }},
      {"precisions", [](const ExtremeSettings&) { return precision_extremes(); }},
      {"splats", [](const ExtremeSettings&) { return splat_extremes(); }},
      {"images", [](const ExtremeSettings& settings) { return image_extremes(settings.folder); }},
      {"depth", [](const ExtremeSettings& settings) { return depth_extremes(settings.folder); }},
      {"whole_model", [](const ExtremeSettings& settings) { return forward_extremes(settings.folder); }}};
  return areas;
}

int run_extremes_benchmark(const ExtremesBenchmarkOptions& options) {
  const at::NoGradGuard no_grad;
  RunFolder folder(options.out, "bench extremes", options, earlier_run(options.overwrite));
  const auto start = std::chrono::steady_clock::now();
  const ExtremeSettings settings{options.camera_sets, folder.path() / "scratch"};
  std::filesystem::create_directories(settings.folder);
  std::vector<ExtremeRow> rows;
  for (const ExtremeArea& area : extreme_areas()) {
    for (auto& row : area.rows(settings)) rows.push_back(std::move(row));
  }
  std::filesystem::remove_all(settings.folder);
  const auto table = extremes_table(rows);
  std::vector<std::string> problems;
  for (const auto& row : rows) {
    if (!row.passed()) problems.push_back(extreme_text(row));
  }
  BenchmarkResults results;
  results.text = table.markdown();
  results.files = {{"extremes.csv", table.csv()}, {"extremes.md", "# Extreme cases\n\n" + table.markdown()}};
  results.report = {
      {"command", "bench extremes"},
      {"options", to_json(options)},
      {"rows", rows.size()},
      {"passed", rows.size() - problems.size()},
      {"seconds", std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count()}};
  results.notes = {{"every case", "extremes.csv"}, {"table", "extremes.md"}};
  return finish_measured_benchmark(folder, results, problems);
}

}  // namespace gld
