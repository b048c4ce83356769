#include "bench/extremes/extremes_benchmark.h"

#include "tests/support/temporary_folder.h"

#include <cmath>
#include <string>

#include <torch/types.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

// The list that gld bench extremes reports, area by area; fewer random sets of cameras.
class Extremes : public testing::TestWithParam<ExtremeArea> {};

TEST_P(Extremes, AreWithinTheirLimits) {
  const at::NoGradGuard no_grad;
  const test::TemporaryFolder folder;
  const auto rows = GetParam().rows({2000, folder.path()});
  EXPECT_GE(rows.size(), 5U);
  for (const auto& row : rows) {
    EXPECT_TRUE(row.passed()) << extreme_text(row);
    // A layer that was not packed for its precision would be nearer.
    if (row.area == "products") {
      EXPECT_GT(row.value, 1e-3) << row.situation << ", " << row.measured;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Areas, Extremes, testing::ValuesIn(extreme_areas()),
                         [](const auto& info) { return info.param.name; });

TEST(ExtremeRow, DoesNotPassAsNotANumber) {
  ExtremeRow row{"norms", "RMS 1e-30", "relative error", 2e-6, 1e-6};
  EXPECT_FALSE(row.passed());
  EXPECT_EQ(extreme_text(row), "norms, RMS 1e-30: relative error is 2e-06, expected at most 1e-06.");
  row.value = std::nan("");
  EXPECT_FALSE(row.passed());
  row.value = 1e-6;
  EXPECT_TRUE(row.passed());
}

}  // namespace
}  // namespace gld
