#pragma once

#include "gld/cameras/camera.h"

#include <cstdint>

namespace gld {

// The same token grid for another number of views.
inline LatentGrid with_views(LatentGrid grid, int64_t views) {
  grid.views = views;
  return grid;
}

}  // namespace gld
