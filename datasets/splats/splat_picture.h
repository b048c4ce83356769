#pragma once

#include "datasets/images/image.h"
#include "gld/splatting/compositing.h"

namespace gld {

// Returns the picture that a camera sees, in 3DGS's colours on black.
CompositedView splat_picture(const GaussianSet& set, const Camera& camera,
                             const ProjectionOptions& projection, const KernelSettings& settings);

// These turn channels from 0 to 1 into 8 bits, and back.
Image image_of(const SplatImage& picture);
SplatImage splat_image_of(const Image& image);

}  // namespace gld
