#pragma once

#include "gld/photogrammetry/photo_consistency.h"
#include "tests/support/textured_plane.h"

#include <functional>

namespace gld::test {

// A photograph of a wall one unit away, whose pixels in column x have that brightness.
inline PicturedView striped_wall(const std::function<double(double)>& brightness) {
  PicturedView view;
  view.camera = camera_before_plane({0, 0, 0}, 0);
  view.width = view.depth.width = view.camera.width;
  view.height = view.depth.height = view.camera.height;
  view.depth.values.assign(static_cast<size_t>(view.width * view.height), 1.0F);
  for (int64_t y = 0; y < view.height; ++y) {
    for (int64_t x = 0; x < view.width; ++x)
      view.rgb.insert(view.rgb.end(), 3, static_cast<float>(brightness(static_cast<double>(x))));
  }
  return view;
}

// The camera that sees the same wall half a pixel further.
inline Camera half_a_pixel_beside(const Camera& camera) {
  return camera_before_plane({0.5 / camera.intrinsics(0, 0), 0, 0}, 0);
}

}  // namespace gld::test
