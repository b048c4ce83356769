#pragma once

#include "datasets/images/image.h"
#include "gld/splatting/compositing.h"

namespace gld {

// The picture that a camera sees, in 3DGS's colours on black.
CompositedView splat_picture(const GaussianSet& set, const Camera& camera,
                             const ProjectionOptions& projection, const KernelSettings& settings);

// Channels 0 to 1 as 8 bits, and back.
Image image_of(const SplatImage& picture);
SplatImage splat_image_of(const Image& image);

}  // namespace gld
