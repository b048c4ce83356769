#pragma once

#include "datasets/images/image.h"
#include "datasets/scenes/scene.h"

namespace gld {

// Draws the cameras of a scene from above and from the side, 1200 x 640 pixels: a triangle per camera that opens
// towards what it sees, blue for the first frame to red for the last, sparse points in grey, and a scale bar.
Image draw_camera_layout(const Scene& scene);

}  // namespace gld
