#pragma once

#include <array>
#include <cstdint>
#include <string>

namespace gld {

// Philox4x32-10 (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3") gives four 32-bit numbers as a
// function of a counter and a key, with no state in between.
using PhiloxCounter = std::array<uint32_t, 4>;
using PhiloxKey = std::array<uint32_t, 2>;
std::array<uint32_t, 4> philox4x32(PhiloxCounter counter, PhiloxKey key);

// Returns the FNV-1a hash of a text: the same with every library, as std::hash is not.
uint64_t fnv1a(const std::string& text);

// Returns the key of a named stream of random numbers: different seeds or names give independent streams.
PhiloxKey philox_key(uint64_t seed, const std::string& stream);

// Fills out with standard normal numbers by Box and Muller's method. Number i of an index depends on key, index and i
// alone, so a part can be drawn without the rest. first must be a multiple of 4.
struct NormalRun {
  PhiloxKey key = {};
  uint64_t index = 0;  // of the view, say
  int64_t first = 0;   // the first number of the index to draw
};
void fill_normal(const NormalRun& run, float* out, int64_t count);

}  // namespace gld
