#pragma once

#include <cstdint>

namespace gld {

constexpr uint64_t kSplitMixIncrement = 0x9E3779B97F4A7C15ULL;  // 2^64 over the golden ratio, odd

// Mixes the bits of a 64-bit number: one step of SplitMix64 (Steele et al. 2014), a bijection.
constexpr uint64_t mixed_bits(uint64_t x) {
  x += kSplitMixIncrement;
  x = (x ^ (x >> 30U)) * 0xBF58476D1CE4E5B9ULL;
  x = (x ^ (x >> 27U)) * 0x94D049BB133111EBULL;
  return x ^ (x >> 31U);
}

}  // namespace gld
