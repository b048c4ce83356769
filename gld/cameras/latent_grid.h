#pragma once

#include "gld/cameras/camera.h"

#include <algorithm>
#include <cstdint>

namespace gld {

// Returns the same token grid for another number of views.
inline LatentGrid with_views(LatentGrid grid, int64_t views) {
  grid.views = views;
  return grid;
}

// Returns how many patches of that side pictures have along a side of so many pixels, at least one: they are resized to
// the nearest whole number.
inline int64_t nearest_whole_patches(int64_t pixels, int64_t patch_side) {
  return std::max<int64_t>(1, (pixels + patch_side / 2) / patch_side);
}

}  // namespace gld
