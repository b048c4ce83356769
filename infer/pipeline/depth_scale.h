#pragma once

#include "gld/cameras/camera.h"
#include "gld/cameras/image_size.h"
#include "gld/cameras/pose_alignment.h"
#include "models/decoders/dpt_head.h"

#include <optional>
#include <string>
#include <vector>

namespace gld {

// How the DPT head's depth and rays lie in the scene. The head has a frame and a unit of its own; its rays tell where it
// thinks the cameras are, and the given cameras tell the true distances between them.
struct DepthScale {
  std::optional<double> scale;             // scene units in one of the head's; nothing where unknown
  std::string unknown_because;             // a phrase, where it is unknown
  std::string detail;                      // what the fit of cameras said, where none fit
  std::vector<Camera> predicted_cameras;   // in the head's frame and unit; empty where none fit
  std::optional<PoseAlignment> alignment;  // of them onto the given cameras
};

// cameras: those of the views of geometry.rays, in their order.
DepthScale depth_scale_of(const GeometryOutput& geometry, const std::vector<Camera>& cameras,
                          const ImageSize& picture);

}  // namespace gld
