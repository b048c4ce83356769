#pragma once

#include <array>
#include <cstdint>

namespace gld {

using Rgb = std::array<uint8_t, 3>;

// The perceptually uniform map "viridis": 0 dark violet, 1 bright yellow; clamped, and 0 for a value that is not a
// number.
Rgb viridis(double position);

}  // namespace gld
