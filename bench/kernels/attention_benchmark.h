#pragma once

#include "bench/support/peak_meter.h"
#include "gld/base/options.h"
#include "gld/report/table.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// gld bench attention times our kernels beside LibTorch's composition, as fractions of the multiply-add peak.
struct AttentionBenchmarkOptions : OptionsGroup {
  std::string out;
  bool overwrite = false;
  std::vector<int64_t> head_dims{48, 128};
  std::vector<int64_t> tokens{1440, 5760};
  std::vector<int64_t> thread_counts;  // empty: 1 and one a core
  int64_t heads = 2;
  int64_t repeats = 7;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

enum class AttentionPass { kForward, kBackward };

struct AttentionBenchmarkRow {
  AttentionPass pass = AttentionPass::kForward;
  int64_t head_dim = 0;
  int64_t tokens = 0;
  int64_t threads = 0;
  // "ours", "composed" (LibTorch's operations, all logits at once), "portable", and "ours_bfloat16" where there is a
  // unit for it
  std::string variant;
  double seconds = 0;  // median
  double seconds_low = 0;
  double seconds_high = 0;
  double flop = 0;
  double fraction_of_peak = 0;  // operations / seconds / the run's peak with as many threads
  double relative_error = 0;    // max |difference| / max |value| against double, for some of the rows
};

// Variants alternate inside every repeat, each after a measurement of the peak, with which all are compared in the end.
std::vector<AttentionBenchmarkRow> attention_benchmark_rows(const AttentionBenchmarkOptions& options,
                                                            PeakMeter& meter);
// The table has columns head_dim, tokens, threads, variant, seconds, fraction_of_peak, relative_error, and rows of one
// pass.
Table attention_benchmark_table(const std::vector<AttentionBenchmarkRow>& rows, AttentionPass pass);

// Writes attention.csv, attention_backward.csv, attention.md, attention.svg, attention.png and report.json into
// options.out. Returns the exit status.
int run_attention_benchmark(const AttentionBenchmarkOptions& options);

}  // namespace gld
