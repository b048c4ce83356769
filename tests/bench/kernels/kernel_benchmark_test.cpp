#include "bench/kernels/attention_benchmark.h"
#include "bench/kernels/forward_benchmark.h"
#include "gld/machine/timing.h"
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

std::string read(const std::filesystem::path& file) {
  std::ifstream stream(file);
  return {std::istreambuf_iterator<char>(stream), {}};
}

std::string first_line(const std::filesystem::path& file) {
  const std::string text = read(file);
  return text.substr(0, text.find('\n'));
}

// A busy machine may hide the peak, which the run then says and ends with.
void expect_status_of_report(int status, const std::filesystem::path& run) {
  const auto report = nlohmann::json::parse(read(run / "report.json"));
  EXPECT_EQ(status, report.at("problems").empty() ? 0 : 1);
  EXPECT_GT(report.at("multiply_add_peak").get<double>(), 1e8);
  EXPECT_TRUE(report.at("measured_with").contains("commit"));
}

TEST(AttentionBenchmark, ReportsAllVariantsWithSmallErrors) {
  AttentionBenchmarkOptions options;
  options.head_dims = {16, 48};
  options.tokens = {100};
  options.thread_counts = {1, 2};
  options.repeats = 1;
  PeakMeter meter;
  const auto rows = attention_benchmark_rows(options, meter);
  const bool bfloat16 = has_matrix_unit(ComputePrecision::kBFloat16);
  ASSERT_EQ(rows.size(), 2U * 2 * (bfloat16 ? 4 : 3) * 2);
  for (const auto& row : rows) {
    SCOPED_TRACE(row.variant);
    EXPECT_GT(row.seconds, 0);
    EXPECT_LE(row.seconds_low, row.seconds);
    EXPECT_GE(row.seconds_high, row.seconds);
    EXPECT_GT(row.fraction_of_peak, 0);
    const double exact = row.pass == AttentionPass::kForward ? 2e-6 : 1e-5;
    EXPECT_LT(row.relative_error, row.variant == "ours_bfloat16" ? 5e-2 : exact);
    EXPECT_GT(row.relative_error, 0);
  }
  EXPECT_EQ(rows[0].variant, "ours");
  EXPECT_EQ(rows[2].variant, "composed");
  EXPECT_EQ(rows[4].variant, "portable");
  if (bfloat16) {
    EXPECT_EQ(rows[6].variant, "ours_bfloat16");
  }
}

TEST(AttentionBenchmark, WritesItsFolder) {
  const test::TemporaryFolder folder;
  AttentionBenchmarkOptions options;
  options.out = (folder.path() / "run").string();
  options.head_dims = {16};
  options.tokens = {20, 40};
  options.repeats = 1;
  expect_status_of_report(run_attention_benchmark(options), options.out);
  EXPECT_EQ(first_line(folder.path() / "run" / "attention.csv"),
            "head_dim,tokens,threads,variant,seconds,fraction_of_peak,relative_error");
  for (const char* file :
       {"attention_backward.csv", "attention.md", "attention.svg", "attention.png", "report.json"}) {
    EXPECT_GT(std::filesystem::file_size(folder.path() / "run" / file), 100U) << file;
  }
}

ForwardBenchmarkOptions small_forward_options(const test::TemporaryFolder& folder) {
  const auto bundle = folder.path() / "model";
  write_random_bundle(bundle, small_bundle_options(), 1);
  ForwardBenchmarkOptions options;
  options.model = bundle.string();
  options.views = 3;
  options.sources = 2;
  options.size = "56x42";
  options.repeats = 1;
  return options;
}

TEST(ForwardBenchmark, OursEqualsTheComposition) {
  const test::TemporaryFolder folder;
  ForwardBenchmarkOptions options = small_forward_options(folder);
  PeakMeter meter;
  const auto rows = forward_benchmark_rows(options, meter);
  ASSERT_EQ(rows.size(), 6U);
  for (const auto& row : rows) {
    SCOPED_TRACE(row.part + " " + row.variant);
    EXPECT_GT(row.tflop, 0);
    EXPECT_GT(row.fraction_of_peak, 0);
    EXPECT_LT(row.relative_difference, 2e-5);
    EXPECT_EQ(row.relative_difference == 0, row.variant == "ours");
  }
  options.out = (folder.path() / "run").string();
  expect_status_of_report(run_forward_benchmark(options), options.out);
  EXPECT_EQ(first_line(folder.path() / "run" / "forward.csv"),
            "part,variant,seconds,lowest,highest,tflop,fraction_of_peak,relative_difference,relative_rms");
  EXPECT_GT(std::filesystem::file_size(folder.path() / "run" / "forward.png"), 100U);
}

TEST(ForwardBenchmark, MeasuresPrecisionsWithoutTheComposition) {
  const test::TemporaryFolder folder;
  ForwardBenchmarkOptions options = small_forward_options(folder);
  options.composed = false;
  options.precisions = {"bfloat16"};
  PeakMeter meter;
  const auto rows = forward_benchmark_rows(options, meter);
  ASSERT_EQ(rows.size(), 6U);
  for (const auto& row : rows) {
    SCOPED_TRACE(row.part + " " + row.variant);
    EXPECT_EQ(row.relative_rms == 0, row.variant == "ours");
    EXPECT_LT(row.relative_rms, 0.02);
  }
}

TEST(ForwardBenchmark, RefusesMoreSourcesThanViews) {
  ForwardBenchmarkOptions options;
  options.views = 3;
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "--source-views: expected fewer than --views, 3, found 4; leave at least one target view.");
  options.views = 8;
  options.size = "13x13";
  EXPECT_EQ(
      test::error_of([&] { options.check(); }),
      "backbone: expected image sides that are positive multiples of 14 pixels, found 13x13; resize or crop the "
      "images.");
}

TEST(Timing, TheMedianIsTheMiddle) {
  EXPECT_EQ(spread_of({3, 1, 2}).median, 2);
  EXPECT_EQ(spread_of({4, 1, 2, 3}).median, 2.5);
  EXPECT_EQ(spread_of({4, 1, 2, 3}).low, 1);
  EXPECT_EQ(spread_of({4, 1, 2, 3}).high, 4);
}

}  // namespace
}  // namespace gld
