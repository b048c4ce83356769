#pragma once

#include "gld/base/mixed_bits.h"

#include <cstdint>
#include <initializer_list>

namespace gld {

// A small generator whose numbers are the same with every compiler and library, unlike the distributions of <random>:
// scenes and view choices must be reproducible from their seed. SplitMix64.
class SeededRandom {
 public:
  // Streams with different keys are independent; the key's order matters.
  explicit SeededRandom(std::initializer_list<uint64_t> key) {
    for (uint64_t part : key) state_ = mixed_bits(state_ ^ part);
  }

  uint64_t bits() {
    state_ += kSplitMixIncrement;
    return mixed_bits(state_);
  }
  // Returns a number in [0, 1).
  double uniform() { return static_cast<double>(bits() >> 11) * 0x1.0p-53; }
  double uniform(double low, double high) { return low + (high - low) * uniform(); }
  // Returns a number in [low, high], both included. The bias is below 2^-40 for the ranges used here.
  int64_t integer(int64_t low, int64_t high) {
    const auto count = static_cast<uint64_t>(high - low) + 1;
    return low + static_cast<int64_t>(static_cast<uint64_t>(uniform() * static_cast<double>(count)));
  }
  bool chance(double probability) { return uniform() < probability; }

 private:
  uint64_t state_ = 0x6A09E667F3BCC909ULL;
};

// Numbers are drawn evenly between these two.
struct DrawRange {
  double low = 0;
  double high = 1;

  double draw(SeededRandom& random) const { return random.uniform(low, high); }
};

}  // namespace gld
