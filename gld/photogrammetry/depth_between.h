#pragma once

#include "gld/photogrammetry/bilinear_neighbours.h"
#include "gld/photogrammetry/planar_depth.h"

#include <algorithm>
#include <cstddef>
#include <limits>

namespace gld {

// Neighbouring depths that differ by more belong to two surfaces: nothing lies between them.
constexpr float kOneSurface = 1.15F;

// Returns the depth at a place that counts from the first cell's middle, interpolated where the cells around it are of
// one surface and else the nearest cell's, and 0 where not known.
inline float depth_between(const PlanarDepth& depth, double x, double y) {
  const BilinearNeighbours around(depth.width, depth.height, x, y);
  float sum = 0, nearest = std::numeric_limits<float>::max(), farthest = 0;
  for (size_t i = 0; i < 4; ++i) {
    const float value = depth.values[around.cells[i]];
    if (!PlanarDepth::known(value)) {
      farthest = std::numeric_limits<float>::max();
      break;
    }
    sum += around.weights[i] * value;
    nearest = std::min(nearest, value);
    farthest = std::max(farthest, value);
  }
  if (farthest <= kOneSurface * nearest) return sum;
  const float value = depth.values[around.nearest()];
  return PlanarDepth::known(value) ? value : 0.0F;
}

}  // namespace gld
