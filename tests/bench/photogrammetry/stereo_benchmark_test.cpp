#include "bench/photogrammetry/stereo_benchmark.h"

#include "tests/support/temporary_folder.h"

#include <filesystem>
#include <fstream>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

StereoBenchmarkOptions small() {
  StereoBenchmarkOptions options;
  options.photograph_count = 3;
  options.side = 128;
  options.repeats = 2;
  options.threads = 2;
  options.stereo.planes = 64;
  options.stereo.coarse_side = 64;
  return options;
}

TEST(StereoBenchmark, ReportsItsStages) {
  PeakMeter meter;
  const auto rows = stereo_benchmark_rows(small(), meter);
  ASSERT_EQ(rows.size(), 3U);
  EXPECT_EQ(rows[0].stage, "sweep");
  EXPECT_EQ(rows[1].stage, "matching");
  EXPECT_EQ(rows[2].stage, "whole");
  for (const auto& row : rows) {
    EXPECT_GT(row.seconds, 0);
    EXPECT_LE(row.seconds_low, row.seconds);
    EXPECT_LE(row.seconds, row.seconds_high);
  }
  EXPECT_GT(rows[0].gigaoperations, 0);
  EXPECT_NEAR(rows[0].fraction_of_peak, 1e9 * rows[0].gigaoperations / meter.peak(2), 1e-9);
  EXPECT_GT(rows[1].gigabytes, 0);
  EXPECT_GT(rows[2].confident_share, 0.3);
  // A plane of 64 is a few pixels of parallax; the parabola finds a tenth of one.
  EXPECT_LT(rows[2].mean_error, 0.02);
}

TEST(StereoBenchmark, WritesItsRunFolder) {
  const test::TemporaryFolder folder;
  StereoBenchmarkOptions options = small();
  options.repeats = 1;
  options.out = (folder.path() / "run").string();
  const int status = run_stereo_benchmark(options);
  for (const char* name : {"stereo.csv", "stereo.md"})
    EXPECT_TRUE(std::filesystem::exists(folder.path() / "run" / name)) << name;
  const auto report = nlohmann::json::parse(std::ifstream(folder.path() / "run" / "report.json"));
  EXPECT_EQ(status, report.at("problems").empty() ? 0 : 1);
  EXPECT_TRUE(report.at("measured_with").contains("commit"));
}

}  // namespace
}  // namespace gld
