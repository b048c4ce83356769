#pragma once

#include "gld/base/options.h"
#include "gld/distributed/process_placement.h"
#include "gld/report/table.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// gld bench processes, started in every process as gld train is, measures what a step of data-parallel training takes,
// how much of it is communication, and what both would be in other numbers of processes.
struct ProcessBenchmarkOptions : OptionsGroup {
  std::string out;
  bool overwrite = false;
  std::string model = "configs/tiny";  // its first generator is trained, with random weights
  ProcessesOptions processes;
  int64_t micro_batches = 2;  // of each process in a step
  std::vector<int64_t> message_kilobytes = {16, 256, 4096, 32768};
  std::vector<int64_t> forecast = {1, 2, 4, 8, 64};
  double forecast_rate = 0;
  int64_t repeats = 5;
  int64_t threads = 0;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Seconds of one of a step's two exchanges between n processes of gradients of b bytes:
//   (n - 1) latency + b (n - 1) / n / rate
// each process sends every other its piece of 1/n of them, and gets as much.
struct MessageCost {
  double latency = 0;  // seconds, >= 0
  double rate = 0;     // bytes a second out of a process and into it; infinite where size made no difference

  double seconds(double bytes, int64_t processes) const;
};

// An exchange that was measured.
struct MeasuredExchange {
  double bytes = 0;
  double seconds = 0;
};

// Fits the line through the smallest and the largest exchange; neither number is below 0. There are at least two
// exchanges of different sizes.
MessageCost message_cost(const std::vector<MeasuredExchange>& exchanges, int64_t processes);

// What a step takes in processes of which each computes as many micro-batches as was measured. Gradients are added up
// at their owners after each of them, and gathered once.
struct ForecastStep {
  int64_t processes = 1;
  double computing = 0;      // seconds
  double communicating = 0;  // seconds
  double efficiency() const { return computing / (computing + communicating); }
};

struct StepToForecast {
  int64_t micro_batches = 1;  // of each process
  double computing = 0;       // seconds of all of these
  double gradient_bytes = 0;
};

ForecastStep forecast_step(const StepToForecast& step, const MessageCost& add, const MessageCost& gather,
                           int64_t processes);

// Rank 0 writes messages.csv, steps.csv, processes.md and report.json into options.out. Returns the exit status.
int run_process_benchmark(const ProcessBenchmarkOptions& options);

}  // namespace gld
