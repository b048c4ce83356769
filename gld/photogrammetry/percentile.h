#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace gld {

// Returns the value that this share (from 0 to 1) of the values lies below; there is at least one value, whose order
// changes.
inline double percentile(std::vector<double>& values, double share) {
  const auto place =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), place, values.end());
  return *place;
}

// Returns the middle one, of an even number the upper of both; there is at least one value, whose order changes.
inline float median(std::vector<float>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace gld
