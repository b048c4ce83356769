#pragma once

#include "datasets/images/image.h"
#include "gld/cameras/camera.h"
#include "infer/export/point_cloud.h"
#include "models/scene_geometry/geometry_placement.h"

#include <vector>

namespace gld {

// The cloud of all views, images one a view, in the frame of cameras_of_depth(). Where there are none, rays lift.
PointCloud point_cloud_of(const GeometryOutput& geometry, const GeometryPlacement& placement,
                          const std::vector<Camera>& given, const std::vector<Image>& images,
                          const PointCloudOptions& options);

// What point_cloud_of uses.
PointLifting lifting_of(const GeometryPlacement& placement, const PointCloudOptions& options);

}  // namespace gld
