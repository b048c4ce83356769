#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

namespace gld {

// Planar depth of a view, row by row, in the unit of its camera's pose. Its pixels cover the image evenly; values that
// are not finite and positive are not known.
struct PlanarDepth {
  int64_t width = 0;
  int64_t height = 0;
  std::vector<float> values;

  static bool known(float depth) { return std::isfinite(depth) && depth > 0; }
};

}  // namespace gld
