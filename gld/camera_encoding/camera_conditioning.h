#pragma once

#include "gld/cameras/relative_cameras.h"

#include <torch/types.h>

namespace gld {

// Where in a pixel the ray starts: column + x, row + y, in pixels. {0.5, 0.5} is the pixel's centre; the published
// checkpoints were trained with {-0.5, 0.5}.
struct PixelOffset {
  double x = 0.5;
  double y = 0.5;
};

// Returns the camera conditioning of a scene, (views, 7, height, width): the source/target mask (0 source, 1 target),
// the normalised ray direction d (3) and the moment o x d (3) in the reference view's frame (Plücker coordinates;
// DESIGN.md section 4, "Cameras"). It is computed in double and cast to dtype. Throws Error when the views differ in
// size.
torch::Tensor camera_conditioning(const RelativeCameras& cameras, const PixelOffset& offset,
                                  torch::Dtype dtype = torch::kFloat32);

// Returns the same without cameras, for the unconditional branch and camera dropout: the mask alone, with zeros
// elsewhere.
torch::Tensor camera_conditioning_without_rays(const Views& views, torch::Dtype dtype = torch::kFloat32);

// Returns camera_from_world of every view with translations scaled, (views, 4, 4) in double, which is what the
// published code hands to PRoPE.
torch::Tensor scaled_camera_from_world(const RelativeCameras& cameras);

}  // namespace gld
