#include "infer/pipeline/placed_cloud.h"

#include "datasets/loading/batching.h"
#include "models/scene_geometry/predicted_cameras.h"

#include <utility>

namespace gld {

DepthMap depth_map_of(const PlanarDepth& depth) {
  DepthMap map;
  map.width = depth.width;
  map.height = depth.height;
  map.metres = depth.values;
  return map;
}

PointLifting lifting_of(const PlacedDepth& depth, const PointCloudOptions& options) {
  if (options.lifting == PointLifting::kPointMaps) return options.lifting;  // in the frame of the rays anyway
  return depth.placement.predicted.empty() && !depth.unit_known() ? PointLifting::kRays : options.lifting;
}

bool cloud_is_in_world(const PlacedDepth& depth, const PointCloudOptions& options) {
  if (depth.placement.alignment) return true;
  return lifting_of(depth, options) == PointLifting::kCameras && depth.unit_known();
}

PointCloud point_cloud_of(const PlacedDepth& depth, const std::vector<Camera>& given,
                          const std::vector<Image>& images, const PointCloudOptions& options) {
  const GeometryOutput& geometry = depth.geometry;
  const GeometryPlacement& placement = depth.placement;
  PointCloudOptions used = options;
  used.lifting = lifting_of(depth, options);
  const bool by_camera = used.lifting == PointLifting::kCameras;
  const bool in_scene = by_camera && !depth.in_scene.empty();
  const std::vector<Camera> cameras = in_scene ? given : cameras_of_depth(placement, given);
  std::vector<PointView> views;
  for (size_t i = 0; i < images.size(); ++i) {
    const auto view_index = static_cast<int64_t>(i);
    PointView view;
    view.camera = cameras.empty() ? given[i] : cameras[i];
    view.image = images[i];
    view.depth = in_scene
                     ? depth_map_of(depth.in_scene[i])
                     : to_depth_map(geometry.depth[view_index].to(torch::kCPU, torch::kFloat32).contiguous());
    const bool of_points = used.lifting == PointLifting::kPointMaps && geometry.points.defined();
    view.confidence =
        to_confidence_map((of_points ? geometry.point_confidence : geometry.depth_confidence)[view_index]);
    view.rays = to_ray_map(geometry.rays[view_index]);
    if (of_points) view.points = to_point_map(geometry.points[view_index]);
    view.world_from_rays = placement.scene_from_model();
    views.push_back(std::move(view));
  }
  return build_point_cloud(views, by_camera && !in_scene && placement.scale ? placement.scale->scale : 1,
                           used);
}

}  // namespace gld
