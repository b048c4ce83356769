#pragma once

#include "gld/cameras/camera.h"
#include "gld/splatting/compositing.h"

namespace gld {

// What is encoded of a view, normalised, and the camera over its pixels. Of no channel where nothing is.
struct LatentView {
  Camera camera;
  SplatImage picture;
};

}  // namespace gld
