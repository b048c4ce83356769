#pragma once

#include "bench/support/peak_meter.h"
#include "gld/base/options.h"
#include "gld/photogrammetry/plane_sweep_stereo.h"
#include "gld/report/table.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// gld bench stereo times depth that photographs agree on, of a painted plane, beside the machine's peaks.
struct StereoBenchmarkOptions : OptionsGroup {
  std::string out;
  bool overwrite = false;
  int64_t photograph_count = 4;
  int64_t side = 448;  // pixels
  int64_t repeats = 5;
  int64_t threads = 0;
  StereoOptions stereo;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

struct StereoBenchmarkRow {
  // "sweep" (a view against the others, all planes), "matching" (semi-global, of that view; on one thread, since views
  // are its parts) or "whole" (both passes of all views)
  std::string stage;
  int64_t threads = 0;
  double seconds = 0;  // median
  double seconds_low = 0;
  double seconds_high = 0;
  double seconds_a_plane = 0;   // of the median, over planes (and views)
  double gigabytes = 0;         // a second, as the loops read and write them; most come from caches
  double gigaoperations = 0;    // a second: of floating point in "sweep", on 16 bits in "matching"
  double fraction_of_peak = 0;  // of the multiply-add peak on as many threads; "sweep" only
  double mean_error = 0;        // |depth - known| / known of confident pixels; "whole" only
  double confident_share = 0;   // "whole" only
};

// meter is that of the run, measured between what is timed.
std::vector<StereoBenchmarkRow> stereo_benchmark_rows(const StereoBenchmarkOptions& options,
                                                      PeakMeter& meter);
// The columns are as the fields of a row.
Table stereo_benchmark_table(const std::vector<StereoBenchmarkRow>& rows);

// Writes stereo.csv, stereo.md and report.json into options.out. Returns the exit status: 1 where the peak was missed.
int run_stereo_benchmark(const StereoBenchmarkOptions& options);

}  // namespace gld
