#pragma once

#include "gld/cameras/camera.h"
#include "gld/cameras/image_size.h"

#include <cstdint>

namespace gld {

struct CameraRow {
  int64_t views = 0;
  int64_t sources = 1;  // the first ones
  ImageSize image;
};

// Returns cameras side by side that look the same way, 0.2 apart, with a lens of 53 degrees: the scene of measurements
// in which only sizes matter.
Views cameras_in_a_row(const CameraRow& row);

}  // namespace gld
