#include "bench/support/peak_meter.h"

#include "bench/support/benchmark_report.h"
#include "gld/tensors/torch_version.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(PeakMeter, KeepsTheBestOfEachThreadCount) {
  PeakMeter meter;
  EXPECT_EQ(meter.peak(1), 0);
  meter.measure(1);
  const double first = meter.peak(1);
  EXPECT_GT(first, 1e8);
  meter.measure(1);
  EXPECT_GE(meter.peak(1), first);
  EXPECT_EQ(meter.peak(2), 0);
}

TEST(PeakMeter, WhatIsFasterThanThePeakIsAProblem) {
  PeakMeter meter;
  meter.measure(1);
  const double peak = meter.peak(1);
  meter.reached("attention (ours)", peak, 1.25, 1);
  EXPECT_TRUE(meter.problems().empty());
  meter.reached("a large matrix product", peak, 0.5, 1);
  meter.reached("attention (ours)", peak, 0.75, 1);
  ASSERT_EQ(meter.problems().size(), 1U);
  EXPECT_THAT(meter.problems()[0], testing::HasSubstr("with 1 thread, and a large matrix product reached"));
  EXPECT_THAT(meter.problems()[0], testing::HasSubstr("no fraction of it counts"));
  // With threads for which no peak is known there is none to be below.
  meter.reached("a step", 1, 1, 2);
  EXPECT_EQ(meter.problems().size(), 2U);
}

TEST(PeakMeter, AProductIsComparedWithThePeakBesideIt) {
  PeakMeter meter;
  meter.measure_with_product();
  EXPECT_GT(meter.product(), 1e8);
  EXPECT_GT(meter.peak(thread_count()), 0);
  EXPECT_EQ(meter.problems().empty(), meter.product() <= meter.peak(thread_count()));
}

TEST(BenchmarkReport, SaysWhatFiguresWereMeasuredWith) {
  const auto with = measured_with();
  for (const char* key : {"program", "commit", "libtorch", "blas", "processor", "vectors"})
    EXPECT_FALSE(with.at(key).get<std::string>().empty()) << key;
  EXPECT_TRUE(with.at("matrix_units").contains("bfloat16"));
  EXPECT_TRUE(with.at("matrix_units").contains("int8"));
}

}  // namespace
}  // namespace gld
