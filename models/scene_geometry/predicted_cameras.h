#pragma once

#include "gld/cameras/camera.h"
#include "gld/photogrammetry/pose_from_rays.h"
#include "gld/photogrammetry/view_maps.h"
#include "models/decoders/geometry_head.h"

#include <vector>

#include <torch/types.h>

namespace gld {

// confidence is (height, width) of any type and device.
ConfidenceMap to_confidence_map(const torch::Tensor& confidence);
// rays are (height, width, 6) of any type and device.
RayMap to_ray_map(const torch::Tensor& rays);
// points are (height, width, 3) of any type and device.
PointMap to_point_map(const torch::Tensor& points);

// Returns the cameras that fit the geometry head's rays best, one a view of geometry.rays: where the model thinks the
// views stand, in its own frame and unit. given are the views' cameras in the scene; their sizes and principal points
// are kept, since cropping may leave a principal point anywhere. Throws Error when no camera fits one of them, or there
// is not one given camera a view.
std::vector<Camera> predicted_cameras(const GeometryOutput& geometry, const std::vector<Camera>& given);

}  // namespace gld
