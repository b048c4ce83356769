#include "bench/processes/process_benchmark.h"

#include "models/bundle/random_bundle.h"
#include "tests/support/error_of.h"
#include "tests/support/forked_processes.h"
#include "tests/support/temporary_folder.h"

#include <cmath>
#include <fstream>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

// Real processes, forked before this one has started a thread.
namespace gld {
namespace {

TEST(MessageCost, IsFoundInWhatItWouldTake) {
  MessageCost truth;
  truth.latency = 2e-4;
  truth.rate = 1.5e9;
  for (const int64_t processes : {2, 5}) {
    std::vector<MeasuredExchange> exchanges;
    for (const double bytes : {4e6, 1e3, 2e5}) exchanges.push_back({bytes, truth.seconds(bytes, processes)});
    const MessageCost found = message_cost(exchanges, processes);
    EXPECT_NEAR(found.latency, truth.latency, 1e-9);
    EXPECT_NEAR(found.rate, truth.rate, 1.0);
  }
  // Three others get a quarter of 8 MB each: 6 MB go out.
  EXPECT_NEAR(truth.seconds(8e6, 4), 3 * 2e-4 + 6e6 / 1.5e9, 1e-12);
}

TEST(MessageCost, NoiseGivesNothingBelowZero) {
  const MessageCost backwards = message_cost({{1e3, 2e-3}, {1e6, 1e-3}}, 2);
  EXPECT_TRUE(std::isinf(backwards.rate));
  EXPECT_DOUBLE_EQ(backwards.seconds(1e9, 2), 2e-3);
  const MessageCost without_latency = message_cost({{1e6, 1e-3}, {4e6, 8e-3}}, 2);
  EXPECT_EQ(without_latency.latency, 0);
  EXPECT_EQ(
      test::error_of([] {
        message_cost({{1e3, 1}, {1e3, 2}}, 2);
      }),
      "message cost: expected exchanges of two sizes at least, between two processes at least, found 2 between 2; "
      "measure more.");
}

TEST(ForecastStep, AddsAfterEachMicroBatchAndGathersOnce) {
  MessageCost add, gather;
  add.latency = 1e-3;
  add.rate = 1e9;
  gather.latency = 2e-3;
  gather.rate = 2e9;
  StepToForecast step;
  step.micro_batches = 3;
  step.computing = 0.6;
  step.gradient_bytes = 4e7;
  const ForecastStep four = forecast_step(step, add, gather, 4);
  EXPECT_NEAR(four.communicating, 3 * (3e-3 + 3e7 / 1e9) + (6e-3 + 3e7 / 2e9), 1e-12);
  EXPECT_NEAR(four.efficiency(), 0.6 / (0.6 + four.communicating), 1e-12);
  EXPECT_EQ(forecast_step(step, add, gather, 1).efficiency(), 1);
}

TEST(ProcessBenchmark, TwoProcessesMeasureEachOther) {
  const test::TemporaryFolder folder;
  auto bundle = small_bundle_options();
  bundle.trained_sizes = {"56x42"};
  save_bundle_options(folder.path() / "model", bundle);
  const auto with = [&](const ProcessesOptions& processes) {
    ProcessBenchmarkOptions options;
    options.out = (folder.path() / "run").string();
    options.model = (folder.path() / "model").string();
    options.processes = processes;
    options.message_kilobytes = {4, 2048};
    options.forecast = {1, 2, 8};
    options.repeats = 2;
    options.threads = 1;
    return options;
  };
  test::in_processes(2, folder.path(),
                     [&](const ProcessesOptions& processes) { run_process_benchmark(with(processes)); });
  std::ifstream file(folder.path() / "run" / "report.json");
  const auto report = nlohmann::json::parse(file);
  EXPECT_EQ(report.at("processes"), 2);
  EXPECT_GT(report.at("step_seconds").get<double>(), report.at("communicating_seconds").get<double>());
  EXPECT_GT(report.at("communicating_seconds").get<double>(), 0);
  std::ifstream steps(folder.path() / "run" / "steps.csv");
  std::string line;
  std::getline(steps, line);
  EXPECT_EQ(line,
            "processes,micro_batches,computing_seconds,communicating_seconds,efficiency,times_one_process");
  int rows = 0;
  while (std::getline(steps, line)) ++rows;
  EXPECT_EQ(rows, 3);
}

TEST(ProcessBenchmark, NeedsAnother) {
  ProcessBenchmarkOptions options;
  options.out = "nowhere";
  EXPECT_EQ(
      test::error_of([&] { run_process_benchmark(options); }),
      "gld bench processes: expected two processes at least, found one; start it with torchrun, or in each process "
      "with --processes.count and so on.");
}

}  // namespace
}  // namespace gld
