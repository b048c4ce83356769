#pragma once

#include "gld/report/plot.h"
#include "gld/report/run_folder.h"

#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// What a benchmark leaves behind.
// NOLINTNEXTLINE(bugprone-exception-escape): moving JSON throws nothing, whatever clang thinks
struct BenchmarkResults {
  std::string text;                                        // printed
  nlohmann::ordered_json report;                           // report.json
  std::vector<std::pair<std::string, std::string>> files;  // name in the run folder, content
  std::vector<std::pair<std::string, Figure>> figures;     // name without ending; drawn as .svg and .png
  std::vector<std::pair<std::string, std::string>> notes;  // lines of the closing box: what it is, where
};

// The end of every benchmark: writes the files, figures and report, prints the text and the closing box, whose last
// line names the report.
void finish_benchmark(RunFolder& folder, const BenchmarkResults& results);

}  // namespace gld
