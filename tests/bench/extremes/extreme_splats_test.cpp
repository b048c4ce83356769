// The area of splats without LibTorch, so that AddressSanitizer sees its loops.
#include "bench/extremes/extremes_benchmark.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(SplatExtremes, AreWithinTheirLimits) {
  const auto rows = splat_extremes();
  EXPECT_GE(rows.size(), 35U);
  for (const ExtremeRow& row : rows)
    EXPECT_TRUE(row.passed()) << row.situation << ", " << row.measured << ": " << row.value;
}

}  // namespace
}  // namespace gld
