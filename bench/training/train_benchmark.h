#pragma once

#include "bench/support/peak_meter.h"
#include "gld/base/options.h"
#include "gld/report/table.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// gld bench train times training steps of M1 with random weights as fractions of the multiply-add peak, and measures
// what recomputing activations saves and costs, and the optimiser's share of a step.
struct TrainBenchmarkOptions : OptionsGroup {
  std::string out;
  bool overwrite = false;
  bool full_width = true;  // full width, the large case and the memory of full depth
  int64_t views = 8;
  int64_t sources = 4;
  std::string size = "252x140";
  std::vector<int64_t> depth = {5, 1};  // of full width; the ratio of the full depth
  int64_t large_views = 4;              // 0 leaves it and the memory of full depth out
  std::string large_size = "504x504";
  std::vector<int64_t> large_depth = {2, 1};
  std::string small_model = "configs/tiny";  // folder with a model.yaml; empty leaves the small model out
  int64_t optimiser_parameters = 50'000'000;
  int64_t repeats = 2;
  int64_t threads = 0;  // all processors

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// One case. Numbers that were not measured are 0, and empty cells in tables: extrapolated memory takes no time, and the
// optimiser is not compared with the peak.
struct TrainBenchmarkRow {
  std::string name;  // the CSV's "case"
  std::string variant;
  double seconds = 0;  // median of one step
  double seconds_low = 0;
  double seconds_high = 0;
  double tflop = 0;             // three forward passes by the cost model
  double fraction_of_peak = 0;  // operations / seconds / the run's peak with as many threads
  int threads = 0;              // of that peak; 0 where there is none to be compared with
  int64_t peak_bytes = 0;       // most tensor memory in use during a step beside what lives on after it
};

std::vector<TrainBenchmarkRow> train_benchmark_rows(const TrainBenchmarkOptions& options, PeakMeter& meter);
// The table has columns case, variant, seconds, tflop, fraction_of_peak, peak_bytes.
Table train_benchmark_table(const std::vector<TrainBenchmarkRow>& rows);

// Writes train.csv, train.md, train.svg, train.png and report.json into options.out. Returns the exit status.
int run_train_benchmark(const TrainBenchmarkOptions& options);

}  // namespace gld
