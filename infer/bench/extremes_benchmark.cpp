#include "infer/bench/extremes_benchmark.h"

#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/report/benchmark_results.h"
#include "gld/report/run_folder.h"

#include <algorithm>
#include <chrono>

#include <ATen/core/grad_mode.h>

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

Table extremes_table(const std::vector<ExtremeRow>& rows) {
  Table table({"area", "situation", "measured", "value", "limit", "passed"});
  for (const auto& row : rows) {
    table.add_row({row.area, row.situation, row.measured, row.value, row.limit,
                   std::string(row.passed() ? "yes" : "NO")});
  }
  return table;
}

std::vector<ExtremeRow> all_extremes(int64_t camera_sets, const std::filesystem::path& folder) {
  std::filesystem::create_directories(folder);
  std::vector<ExtremeRow> rows;
  for (const auto& part :
       {camera_extremes(camera_sets), attention_extremes(), norm_extremes(), flow_extremes(),
        precision_extremes(), image_extremes(folder), depth_extremes(folder), forward_extremes(folder)}) {
    rows.insert(rows.end(), part.begin(), part.end());
  }
  std::filesystem::remove_all(folder);
  return rows;
}

int run_extremes_benchmark(const ExtremesBenchmarkOptions& options) {
  const at::NoGradGuard no_grad;
  RunFolder folder(options.out, "bench extremes", options, earlier_run(options.overwrite));
  const auto start = std::chrono::steady_clock::now();
  const auto rows = all_extremes(options.camera_sets, folder.path() / "scratch");
  const auto table = extremes_table(rows);
  const auto passed =
      std::count_if(rows.begin(), rows.end(), [](const ExtremeRow& row) { return row.passed(); });
  BenchmarkResults results;
  results.text = table.markdown();
  results.files = {{"extremes.csv", table.csv()}, {"extremes.md", "# Extreme cases\n\n" + table.markdown()}};
  results.report = {
      {"command", "bench extremes"},
      {"options", to_json(options)},
      {"rows", rows.size()},
      {"passed", passed},
      {"seconds", std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count()}};
  results.notes = {{"every case", "extremes.csv"}, {"table", "extremes.md"}};
  finish_benchmark(folder, results);
  return passed == static_cast<int64_t>(rows.size()) ? 0 : 1;
}

}  // namespace gld
