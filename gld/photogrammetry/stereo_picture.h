#pragma once

#include "gld/cameras/camera.h"
#include "gld/kernels/kernel_table.h"
#include "gld/photogrammetry/photo_consistency.h"

#include <cstdint>
#include <vector>

namespace gld {

// A photograph made ready for plane sweeps.
struct StereoPicture {
  Camera camera;  // of this size
  int64_t width = 0;
  int64_t height = 0;
  // (height, width) brightness less its mean, as a share of the largest such difference: from -1 to 1, so that neither
  // exposure nor offset matters to what is rounded. 0 where not valid.
  std::vector<float> brightness;
  std::vector<uint8_t>
      valid;  // (height, width) 0 where a window about the pixel has a value that is not finite
  std::vector<uint64_t> texels;  // (height + 2, width + 2), as TexelPicture has them
  float deviation = 0;           // root mean square of brightness

  TexelPicture texel_picture() const { return {texels.data(), width + 2, height + 2}; }
};

// Returns the photograph reduced by area to at most largest_side pixels a side (never enlarged).
StereoPicture stereo_picture(const PicturedView& view, int64_t largest_side, int64_t window_radius);

}  // namespace gld
