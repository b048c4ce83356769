#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace gld {

// The value that this share (from 0 to 1) of the values lies below; at least one value, whose order changes.
inline double percentile(std::vector<double>& values, double share) {
  const auto place =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), place, values.end());
  return *place;
}

}  // namespace gld
