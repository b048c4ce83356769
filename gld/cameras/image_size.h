#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace gld {

struct ImageSize {
  int64_t width = 0;   // pixels
  int64_t height = 0;  // pixels
};

// Returns the size of the same aspect with the longer side at most `side`; smaller sizes stay as they are.
inline ImageSize image_within(int64_t width, int64_t height, int64_t side) {
  const int64_t longer = std::max(width, height);
  if (longer <= side) return {width, height};
  const double factor = static_cast<double>(side) / static_cast<double>(longer);
  return {std::max<int64_t>(1, std::llround(static_cast<double>(width) * factor)),
          std::max<int64_t>(1, std::llround(static_cast<double>(height) * factor))};
}

}  // namespace gld
