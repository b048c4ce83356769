#include "bench/training/train_benchmark.h"

#include "gld/machine/matrix_unit.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

TrainBenchmarkOptions without_full_width(const std::filesystem::path& folder) {
  TrainBenchmarkOptions options;
  options.out = (folder / "run").string();
  options.small_model = (folder / "model").string();
  options.full_width = false;
  options.optimiser_parameters = 10000;
  options.repeats = 1;
  return options;
}

TEST(TrainBenchmark, MeasuresTheSmallModelAndTheOptimiser) {
  const test::TemporaryFolder folder;
  auto bundle = small_bundle_options();
  bundle.trained_sizes = {"56x42"};
  write_random_bundle(folder.path() / "model", bundle, 1);
  const auto options = without_full_width(folder.path());
  PeakMeter meter;
  const auto rows = train_benchmark_rows(options, meter);
  // One more where the processor has a unit for bfloat16.
  ASSERT_EQ(rows.size(), has_matrix_unit(ComputePrecision::kBFloat16) ? 5U : 4U);
  EXPECT_EQ(rows[0].name, "small_model");
  const auto& measured = rows[rows.size() - 2];
  const auto& scaled = rows.back();
  EXPECT_EQ(scaled.variant, "scaled_to_full_size");
  for (const auto& row : rows) {
    EXPECT_GT(row.seconds, 0) << row.name;
    EXPECT_GT(row.tflop, 0) << row.name;
  }
  EXPECT_GT(rows[0].fraction_of_peak, 0);
  EXPECT_GT(scaled.seconds, 10 * measured.seconds);
  const int status = run_train_benchmark(options);
  const auto report = nlohmann::json::parse(std::ifstream(folder.path() / "run" / "report.json"));
  EXPECT_EQ(status, report.at("problems").empty() ? 0 : 1);
  std::ifstream stream(folder.path() / "run" / "train.csv");
  std::string header;
  std::getline(stream, header);
  EXPECT_EQ(header, "case,variant,seconds,tflop,fraction_of_peak,peak_bytes");
}

TEST(TrainBenchmark, WhatIsNotMeasuredIsAnEmptyCell) {
  TrainBenchmarkRow step;
  step.name = "full_width";
  step.variant = "keep";
  step.seconds = 2;
  step.tflop = 1.5;
  step.fraction_of_peak = 0.5;
  step.peak_bytes = 1000;
  TrainBenchmarkRow extrapolated;
  extrapolated.name = "extrapolated_504x504x8";
  extrapolated.variant = "keep_stored";
  extrapolated.peak_bytes = 44000;
  EXPECT_EQ(train_benchmark_table({step, extrapolated}).csv(),
            "case,variant,seconds,tflop,fraction_of_peak,peak_bytes\n"
            "full_width,keep,2,1.5,0.5,1000\n"
            "extrapolated_504x504x8,keep_stored,,,,44000\n");
}

TEST(TrainBenchmark, RefusesADepthOfOneNumber) {
  TrainBenchmarkOptions options;
  options.depth = {5};
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "--depth: expected two numbers, found 1; write for example --depth 5,1.");
}

}  // namespace
}  // namespace gld
