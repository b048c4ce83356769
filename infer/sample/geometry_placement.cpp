#include "infer/sample/geometry_placement.h"

#include "datasets/loading/batching.h"
#include "gld/base/error.h"
#include "infer/pipeline/predicted_cameras.h"

#include <utility>

namespace gld {

Similarity GeometryPlacement::scene_from_model() const {
  if (!alignment) return {};
  Similarity scene_from_model = alignment->b_from_a;
  if (!scale) return scene_from_model;
  // Another estimator's scale keeps the middle of the cameras where the alignment puts it.
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const Camera& camera : predicted) {
    middle += camera.world_from_camera.translation() / static_cast<double>(predicted.size());
  }
  scene_from_model.translation +=
      (scene_from_model.scale - scale->scale) * (scene_from_model.rotation * middle);
  scene_from_model.scale = scale->scale;
  return scene_from_model;
}

GeometryPlacement place_geometry(const GeometryOutput& geometry, const std::vector<Camera>& given) {
  GeometryPlacement placement;
  try {
    placement.predicted = predicted_cameras(geometry, given);
  } catch (const Error& error) {
    placement.problem = error.what();
    return placement;
  }
  placement.alignment = align_poses(placement.predicted, given);
  std::vector<DepthScale> estimates;
  if (auto estimate = depth_scale_from_poses(*placement.alignment)) estimates.push_back(*estimate);
  placement.scale = surest_depth_scale(estimates);
  return placement;
}

std::vector<Camera> cameras_of_depth(const GeometryPlacement& placement, const std::vector<Camera>& given) {
  if (placement.scale) return given;
  std::vector<Camera> cameras = placement.predicted;
  const Similarity scene_from_model = placement.scene_from_model();
  for (Camera& camera : cameras) {
    const Eigen::Vector3d centre = camera.world_from_camera.translation();
    camera.world_from_camera.linear() = scene_from_model.rotation * camera.world_from_camera.linear();
    camera.world_from_camera.translation() = scene_from_model * centre;
  }
  return cameras;
}

PointLifting lifting_of(const GeometryPlacement& placement, const PointCloudOptions& options) {
  return placement.predicted.empty() ? PointLifting::kRays : options.lifting;
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
    view.confidence = to_confidence_map(geometry.depth_confidence[view_index]);
    view.rays = to_ray_map(geometry.rays[view_index]);
    view.world_from_rays = placement.scene_from_model();
    views.push_back(std::move(view));
  }
  const bool by_camera = used.lifting == PointLifting::kCameras;
  return build_point_cloud(views, by_camera && placement.scale ? placement.scale->scale : 1, used);
}

}  // namespace gld
