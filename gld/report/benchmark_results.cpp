#include "gld/report/benchmark_results.h"

#include "gld/base/atomic_file.h"

#include <iostream>

namespace gld {

void finish_benchmark(RunFolder& folder, const BenchmarkResults& results) {
  for (const auto& [name, content] : results.files) write_file_atomically(folder.path() / name, content);
  for (const auto& [name, figure] : results.figures) {
    write_svg(figure, folder.path() / (name + ".svg"));
    write_png(figure, folder.path() / (name + ".png"));
  }
  folder.write_report(results.report);
  for (const auto& [what, where] : results.notes) folder.note(what, where);
  folder.note("report", "report.json");
  std::cout << results.text << "\n" << folder.closing_box();
}

}  // namespace gld
