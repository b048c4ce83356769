#pragma once

#include <cstdint>

// How products are cut up.
namespace gld {

inline int64_t parts_of(int64_t count, int64_t most) { return (count + most - 1) / most; }

inline int64_t rounded_up(int64_t count, int64_t step) { return parts_of(count, step) * step; }

// Returns the size of equal shares of count, none above most, rounded up to a multiple of step.
inline int64_t equal_share(int64_t count, int64_t most, int64_t step) {
  return rounded_up(parts_of(count, parts_of(count, most)), step);
}

// Rows of the left operand that are packed at once, and parts that threads take of them where there are few blocks of
// columns.
constexpr int64_t kRowsPackedAtOnce = 1152;
constexpr int64_t kRowsAPart = 128;
constexpr int64_t kPartsAThread = 2;

}  // namespace gld
