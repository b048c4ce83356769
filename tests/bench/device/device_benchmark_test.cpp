#include "bench/device/device_benchmark.h"

#include "models/bundle/random_bundle.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>
#include <fstream>
#include <map>
#include <string>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

// The CPU is a device too, whose memory is counted elsewhere.
TEST(DeviceBenchmark, MeasuresEveryPartInBothPrecisions) {
  const test::TemporaryFolder folder;
  auto bundle = small_bundle_options();
  bundle.trained_sizes = {"56x42"};
  write_random_bundle(folder.path() / "model", bundle, 1);
  DeviceBenchmarkOptions options;
  options.out = (folder.path() / "run").string();
  options.device = "cpu";
  options.model = (folder.path() / "model").string();
  options.views = 3;
  options.sources = 1;
  options.size = "56x42";
  options.product_side = 256;
  options.repeats = 3;
  options.threads = 1;
  const auto rows = device_benchmark_rows(options);
  std::map<std::string, int> parts;
  for (const auto& row : rows) {
    ++parts[row.part];
    EXPECT_GT(row.seconds, 0) << row.part << " " << row.variant;
    EXPECT_LE(row.seconds_low, row.seconds);
    EXPECT_GE(row.seconds_high, row.seconds);
    EXPECT_EQ(row.problem, "") << row.part;
    EXPECT_EQ(row.tflop > 0, row.part != "optimiser") << row.part;
  }
  EXPECT_EQ(parts, (std::map<std::string, int>{
                       {"evaluation", 2}, {"optimiser", 1}, {"product", 2}, {"training_step", 4}}));
  EXPECT_EQ(rows[2].relative_rms, 0) << "the reference";
  EXPECT_GT(rows[3].relative_rms, 1e-5) << rows[3].variant;
  EXPECT_LT(rows[3].relative_rms, 0.05);

  EXPECT_EQ(run_device_benchmark(options), 0);
  const auto report = nlohmann::json::parse(std::ifstream(folder.path() / "run" / "report.json"));
  EXPECT_FALSE(report.at("device").get<std::string>().empty());
  std::ifstream stream(folder.path() / "run" / "device.csv");
  std::string header;
  std::getline(stream, header);
  EXPECT_EQ(
      header,
      "part,variant,seconds,lowest,highest,tflop,fraction_of_peak,relative_rms,resident_bytes,most_bytes,problem");
}

TEST(DeviceBenchmark, LeavesTheFullSizeToAGpu) {
  DeviceBenchmarkOptions options;
  options.out = "run";
  EXPECT_EQ(
      test::error_of([&] { options.check(); }),
      "--device: expected a GPU for the full-size M1, which a CPU would train for an hour, found cpu; add --device "
      "cuda, or --model with the folder of a small model.");
}

TEST(DeviceBenchmark, NeedsATargetView) {
  DeviceBenchmarkOptions options;
  options.views = options.sources = 4;
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "--source-views: expected fewer than --views, 4, found 4; leave at least one target view.");
}

}  // namespace
}  // namespace gld
