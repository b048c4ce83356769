#pragma once

#include "datasets/images/image.h"
#include "gld/cameras/camera.h"

namespace gld {

struct DepthView {
  Camera camera;
  DepthMap depth;
};

struct WarpResult {
  double share_in_view = 0;   // of a's known pixels that project into b, in front of it
  double share_agreeing = 0;  // of those, with b's depth within the tolerance
  double median_error = 0;    // of those that agree: |z - b's depth| / z
};

// Carries every pixel of a to b by its depth and compares with b's own depth there (bilinear). relative_tolerance tells
// agreement from occlusion.
WarpResult warp_depth(const DepthView& a, const DepthView& b, double relative_tolerance);

}  // namespace gld
