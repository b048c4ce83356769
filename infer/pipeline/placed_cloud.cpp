#include "infer/pipeline/placed_cloud.h"

#include "datasets/loading/batching.h"
#include "models/scene_geometry/predicted_cameras.h"

#include <utility>

namespace gld {

PointLifting lifting_of(const GeometryPlacement& placement, const PointCloudOptions& options) {
  if (options.lifting == PointLifting::kPointMaps) return options.lifting;  // in the frame of the rays anyway
  return placement.predicted.empty() && !placement.scale ? PointLifting::kRays : options.lifting;
}

PointCloud point_cloud_of(const GeometryOutput& geometry, const GeometryPlacement& placement,
                          const std::vector<Camera>& given, const std::vector<Image>& images,
                          const PointCloudOptions& options) {
  PointCloudOptions used = options;
  used.lifting = lifting_of(placement, options);
  const std::vector<Camera> cameras = cameras_of_depth(placement, given);
  std::vector<PointView> views;
  for (size_t i = 0; i < images.size(); ++i) {
    const auto view_index = static_cast<int64_t>(i);
    PointView view;
    view.camera = cameras.empty() ? given[i] : cameras[i];
    view.image = images[i];
    view.depth = to_depth_map(geometry.depth[view_index].to(torch::kCPU, torch::kFloat32).contiguous());
    const bool of_points = used.lifting == PointLifting::kPointMaps && geometry.points.defined();
    view.confidence =
        to_confidence_map((of_points ? geometry.point_confidence : geometry.depth_confidence)[view_index]);
    view.rays = to_ray_map(geometry.rays[view_index]);
    if (of_points) view.points = to_point_map(geometry.points[view_index]);
    view.world_from_rays = placement.scene_from_model();
    views.push_back(std::move(view));
  }
  const bool by_camera = used.lifting == PointLifting::kCameras;
  return build_point_cloud(views, by_camera && placement.scale ? placement.scale->scale : 1, used);
}

}  // namespace gld
