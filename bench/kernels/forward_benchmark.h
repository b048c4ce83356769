#pragma once

#include "bench/support/peak_meter.h"
#include "gld/base/options.h"
#include "gld/report/table.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// gld bench forward times one evaluation of M1 beside LibTorch's plain composition, as fractions of the multiply-add
// peak.
struct ForwardBenchmarkOptions : OptionsGroup {
  std::string out;
  bool overwrite = false;
  std::string model;  // a bundle; empty: DA3-Base's M1 at full size with random weights
  int64_t views = 8;
  int64_t sources = 4;
  std::string size = "252x140";
  std::vector<std::string> precisions;  // beside float32
  bool composed = true;
  int64_t repeats = 3;
  int64_t threads = 0;  // all processors

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

struct ForwardBenchmarkRow {
  std::string part;     // "condition_encoder", "velocity_decoder" or "evaluation" (both, in one)
  std::string variant;  // "ours", "composed", or a precision of --precisions
  double seconds = 0;   // median
  double seconds_low = 0;
  double seconds_high = 0;
  double tflop = 0;  // by the cost model
  // Median over repeats of operations / seconds / peak of float32 multiply-adds measured just before. Above 1 where a
  // faster unit multiplies: rows of all precisions are fractions of the same.
  double fraction_of_peak = 0;
  double relative_difference = 0;  // max |difference| / max |value| from ours in float32
  double relative_rms = 0;         // RMS of the difference from it over its RMS
};

std::vector<ForwardBenchmarkRow> forward_benchmark_rows(const ForwardBenchmarkOptions& options,
                                                        PeakMeter& meter);
// The table has columns part, variant, seconds, lowest, highest, tflop, fraction_of_peak, relative_difference,
// relative_rms.
Table forward_benchmark_table(const std::vector<ForwardBenchmarkRow>& rows);

// Writes forward.csv, forward.md, forward.svg, forward.png and report.json into options.out. Returns the exit status.
int run_forward_benchmark(const ForwardBenchmarkOptions& options);

}  // namespace gld
