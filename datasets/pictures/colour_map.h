#pragma once

#include <array>
#include <cstdint>

namespace gld {

using Rgb = std::array<uint8_t, 3>;

// Returns a colour of the perceptually uniform map "viridis": 0 is dark violet, 1 bright yellow; position is clamped,
// and 0 for a value that is not a number.
Rgb viridis(double position);

}  // namespace gld
