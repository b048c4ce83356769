#pragma once

#include "gld/base/options.h"
#include "gld/report/table.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// gld bench device times one evaluation of M1 and steps of its training on a GPU, in float32 and bfloat16, as fractions
// of what that GPU reaches with large matrix products in the same run, and the memory that they take.
struct DeviceBenchmarkOptions : OptionsGroup {
  std::string out;
  bool overwrite = false;
  std::string device = "cpu";
  std::string model;  // a model folder, of which the options count; empty for the full-size M1
  int64_t views = 8;
  int64_t sources = 4;
  std::string size = "504x504";  // width x height in pixels
  int64_t product_side = 8192;   // of the square matrices whose product is the peak
  int64_t repeats = 10;          // of each, after two that warm up
  int64_t threads = 0;           // all processors

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// What was timed of one part in one variant. A part that had no room on the device has its sentence and no numbers.
struct DeviceBenchmarkRow {
  std::string part;     // product, evaluation, training_step, optimiser
  std::string variant;  // float32, bfloat16; of training_step with "_recomputed" where activations are
  double seconds = 0;   // median
  double seconds_low = 0;
  double seconds_high = 0;
  double tflop = 0;             // 0: not compared with products
  double fraction_of_peak = 0;  // operations / seconds / the run's products in the same precision
  double relative_rms = 0;      // of an evaluation, from the one in float32
  int64_t resident_bytes = 0;   // weights and the scene, and of training gradients, moments and average
  int64_t most_bytes = 0;       // of tensors at a time, resident_bytes among them; 0: unknown
  std::string problem;          // "no room on the device"
};

// It runs on the device of the options, after use_threads. It writes nothing.
std::vector<DeviceBenchmarkRow> device_benchmark_rows(const DeviceBenchmarkOptions& options);
Table device_benchmark_table(const std::vector<DeviceBenchmarkRow>& rows);

// Writes device.csv, device.md and report.json into options.out. Returns the exit status.
int run_device_benchmark(const DeviceBenchmarkOptions& options);

}  // namespace gld
