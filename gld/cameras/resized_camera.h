#pragma once

#include "gld/cameras/camera.h"

#include <cstdint>

namespace gld {

// Returns the same lens over a picture of another size in pixels; both sides may be scaled by factors of their own.
inline Camera resized_camera(Camera camera, int64_t width, int64_t height) {
  camera.intrinsics.row(0) *= static_cast<double>(width) / static_cast<double>(camera.width);
  camera.intrinsics.row(1) *= static_cast<double>(height) / static_cast<double>(camera.height);
  camera.width = width;
  camera.height = height;
  return camera;
}

}  // namespace gld
