#include "gld/photogrammetry/membrane.h"

#include <cmath>
#include <cstdint>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(Membrane, IsTheOneKnownValueEverywhere) {
  for (const int64_t width : {1, 7, 32}) {
    const int64_t height = 5;
    std::vector<float> values(static_cast<size_t>(2 * width * height), 0.0F);
    std::vector<float> weights(static_cast<size_t>(width * height), 0.0F);
    const size_t known = weights.size() / 2;
    weights[known] = 0.25F;
    values[2 * known] = 3;
    values[2 * known + 1] = -1;
    const auto surface = membrane(width, height, 2, values, weights);
    for (size_t i = 0; i < weights.size(); ++i) {
      ASSERT_NEAR(surface[2 * i], 3, 1e-5) << width << " " << i;
      ASSERT_NEAR(surface[2 * i + 1], -1, 1e-5) << width << " " << i;
    }
  }
}

TEST(Membrane, KeepsWhatIsKnownAndStaysBetweenItsValues) {
  constexpr int64_t kSide = 32;
  std::vector<float> values(kSide * kSide, 0.0F), weights(kSide * kSide, 0.0F);
  for (int64_t row = 0; row < kSide; ++row) {
    weights[static_cast<size_t>(row * kSide)] = weights[static_cast<size_t>(row * kSide + kSide - 1)] = 1;
    values[static_cast<size_t>(row * kSide + kSide - 1)] = 1;
  }
  const auto surface = membrane(kSide, kSide, 1, values, weights);
  for (int64_t row = 0; row < kSide; ++row) {
    const float* line = surface.data() + row * kSide;
    EXPECT_EQ(line[0], 0);
    EXPECT_EQ(line[kSide - 1], 1);
    for (int64_t column = 0; column < kSide; ++column) {
      EXPECT_GE(line[column], 0);
      EXPECT_LE(line[column], 1);
      EXPECT_NEAR(line[column] + line[kSide - 1 - column], 1, 1e-6);  // both borders count alike
    }
  }
}

TEST(Membrane, OfNothingKnownIsZeroAndValuesWithoutWeightSayNothing) {
  const auto surface = membrane(6, 4, 1, std::vector<float>(24, std::nanf("")), std::vector<float>(24, 0.0F));
  for (const float value : surface) EXPECT_EQ(value, 0);
}

}  // namespace
}  // namespace gld
