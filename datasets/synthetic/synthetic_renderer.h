#pragma once

#include "datasets/images/image.h"
#include "datasets/synthetic/synthetic_world.h"
#include "gld/cameras/camera.h"

namespace gld {

// Draws a generated scene by ray casting: matte surfaces and glossy ones (reflections of lamps), one ray a pixel, nine
// where surfaces meet, soft shadows from round lamps, darker corners. The camera must be inside the room. It is
// deterministic and safe from several threads.
Image render_image(const SyntheticWorld& world, const Camera& camera);

// Returns exact planar depth of the pixel centres, in metres.
DepthMap render_depth(const SyntheticWorld& world, const Camera& camera);

}  // namespace gld
