#include "gld/base/philox.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

// The known answers that the authors of Philox publish with Random123.
TEST(Philox, KnownAnswers) {
  EXPECT_EQ(philox4x32({0, 0, 0, 0}, {0, 0}),
            (std::array<uint32_t, 4>{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8}));
  EXPECT_EQ(philox4x32({0xffffffff, 0xffffffff, 0xffffffff, 0xffffffff}, {0xffffffff, 0xffffffff}),
            (std::array<uint32_t, 4>{0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd}));
  EXPECT_EQ(philox4x32({0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344}, {0xa4093822, 0x299f31d0}),
            (std::array<uint32_t, 4>{0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1}));
}

std::vector<float> normal_numbers(const NormalRun& run, int64_t count) {
  std::vector<float> numbers(static_cast<size_t>(count));
  fill_normal(run, numbers.data(), count);
  return numbers;
}

TEST(Philox, NormalNumbersHaveTheMomentsOfANormal) {
  NormalRun run;
  run.key = philox_key(0, "level 1");
  const int64_t count = 400000;
  double first = 0, second = 0, third = 0, fourth = 0;
  for (const float x : normal_numbers(run, count)) {
    first += x;
    second += static_cast<double>(x) * x;
    third += std::pow(x, 3);
    fourth += std::pow(x, 4);
  }
  const auto n = static_cast<double>(count);
  EXPECT_NEAR(first / n, 0, 5 / std::sqrt(n));
  EXPECT_NEAR(second / n, 1, 5 * std::sqrt(2 / n));
  EXPECT_NEAR(third / n, 0, 5 * std::sqrt(15 / n));
  EXPECT_NEAR(fourth / n, 3, 5 * std::sqrt(96 / n));
}

TEST(Philox, APartIsThePartOfTheWhole) {
  NormalRun run;
  run.key = philox_key(5, "level 0");
  run.index = 3;
  const auto whole = normal_numbers(run, 101);
  run.first = 40;
  const auto part = normal_numbers(run, 61);
  for (size_t i = 0; i < part.size(); ++i) EXPECT_EQ(part[i], whole[i + 40]);
}

TEST(Philox, SeedsStreamsAndIndicesAreUncorrelated) {
  const int64_t count = 20000;
  const auto draw = [&](uint64_t seed, const char* stream, uint64_t index) {
    NormalRun run;
    run.key = philox_key(seed, stream);
    run.index = index;
    return normal_numbers(run, count);
  };
  const auto base = draw(1, "level 1", 0);
  for (const auto& other : {draw(2, "level 1", 0), draw(1, "level 0", 0), draw(1, "level 1", 1)}) {
    double product = 0;
    for (size_t i = 0; i < base.size(); ++i) product += static_cast<double>(base[i]) * other[i];
    EXPECT_NEAR(product / static_cast<double>(count), 0, 5 / std::sqrt(static_cast<double>(count)));
  }
}

}  // namespace
}  // namespace gld
