#pragma once

#include "datasets/images/image.h"
#include "gld/cameras/camera.h"
#include "gld/photogrammetry/planar_depth.h"
#include "infer/export/point_cloud.h"
#include "models/scene_geometry/geometry_placement.h"

#include <vector>

namespace gld {

// What is known of the depth of all views of a sample.
struct PlacedDepth {
  const GeometryOutput& geometry;
  const GeometryPlacement& placement;
  // In the unit of the given cameras, one a view (PipelineResult::view_depth); empty where the head alone says depth.
  std::vector<PlanarDepth> in_scene = {};

  bool unit_known() const { return !in_scene.empty() || placement.scale.has_value(); }
};

// Returns the cloud of all views, images being one a view: with depth in the unit of the given cameras it is in their
// world, else in the frame of cameras_of_depth(). Where there are none, rays lift, and the head's own depth with them.
PointCloud point_cloud_of(const PlacedDepth& depth, const std::vector<Camera>& given,
                          const std::vector<Image>& images, const PointCloudOptions& options);

// Returns whether that cloud lies in the world of the given cameras, by their unit or by how the model's own cameras
// fit them, and not in a frame of the model's own.
bool cloud_is_in_world(const PlacedDepth& depth, const PointCloudOptions& options);

// Returns the depth as a file and a cloud take it.
DepthMap depth_map_of(const PlanarDepth& depth);

// Returns what point_cloud_of uses.
PointLifting lifting_of(const PlacedDepth& depth, const PointCloudOptions& options);

}  // namespace gld
