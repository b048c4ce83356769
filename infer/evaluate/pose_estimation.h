#pragma once

#include "gld/cameras/camera.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "models/decoders/geometry_head.h"

#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// How cameras are found in what a geometry head says of views.
enum class PoseEstimator {
  kNone,
  kOurs,  // gld/photogrammetry/pose_from_rays.h, with the given principal points
  kDa3,   // gld/photogrammetry/published_pose_from_rays.h
  kGld,
  kVggt,        // VGGT's camera head, whose cameras are the heads' rays
  kDa3Decoder,  // DA3's camera decoder, which reads the views' camera tokens and no rays
};
const std::vector<std::string>&
pose_estimator_names();  // "none", "ours", "da3", "gld", "vggt", "da3_decoder"

// Returns one camera a view of geometry.rays, in their frame and unit. given are the scene's cameras, for sizes and
// (ours) principal points. Throws Error where no camera fits a view, and for kNone.
std::vector<Camera> estimated_cameras(PoseEstimator estimator, const GeometryOutput& geometry,
                                      const std::vector<Camera>& given);

}  // namespace gld
