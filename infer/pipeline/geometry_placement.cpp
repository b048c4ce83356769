#include "infer/pipeline/geometry_placement.h"

#include "datasets/loading/batching.h"
#include "gld/base/error.h"
#include "gld/cameras/photo_consistency.h"
#include "gld/cameras/scale_from_known_depth.h"
#include "infer/pipeline/predicted_cameras.h"
#include "infer/pipeline/scene_request.h"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

PlanarDepth planar_depth(const torch::Tensor& depth) {
  const auto values = depth.to(torch::kCPU, torch::kFloat32).contiguous();
  const float* first = values.data_ptr<float>();
  return {values.size(1), values.size(0), {first, first + values.numel()}};
}

std::optional<DepthScale> scale_from_photographs(const GeometryOutput& geometry,
                                                 const std::vector<Camera>& given,
                                                 const torch::Tensor& photographs) {
  std::vector<PicturedView> views;
  for (size_t i = 0; i < given.size(); ++i) {
    const auto number = static_cast<int64_t>(i);
    PicturedView view;
    view.camera = given[i];
    view.depth = planar_depth(geometry.depth[number]);
    view.width = given[i].width;
    view.height = given[i].height;
    if (number < photographs.size(0)) {
      const auto pixels =
          photographs[number].to(torch::kCPU, torch::kFloat32).permute({1, 2, 0}).contiguous();
      const float* first = pixels.data_ptr<float>();
      view.width = pixels.size(1);
      view.height = pixels.size(0);
      view.rgb.assign(first, first + pixels.numel());
    }
    views.push_back(std::move(view));
  }
  return scale_from_photo_consistency(views, "photographs");
}

std::vector<DepthView> depth_views(const GeometryOutput& geometry, const std::vector<Camera>& given) {
  std::vector<DepthView> views;
  for (size_t i = 0; i < given.size(); ++i) {
    views.push_back({given[i], planar_depth(geometry.depth[static_cast<int64_t>(i)])});
  }
  return views;
}

std::vector<DepthScale> estimates_from_depth(const GeometryOutput& geometry, const std::vector<Camera>& given,
                                             const ScaleEvidence& evidence) {
  std::vector<DepthScale> estimates;
  const auto add = [&](const std::optional<DepthScale>& estimate) {
    if (estimate) estimates.push_back(*estimate);
  };
  if (evidence.photographs.defined() && evidence.photographs.size(0) > 1) {
    add(scale_from_photographs(geometry, given, evidence.photographs));
  }
  if (!evidence.points_in_world.empty()) {
    add(scale_from_sparse_points(depth_views(geometry, given), evidence.points_in_world));
  }
  if (!evidence.source_depth.empty()) {
    std::vector<PlanarDepth> measured;
    for (const DepthMap& map : evidence.source_depth) {
      measured.push_back({map.width, map.height, map.metres});
    }
    add(scale_from_measured_depth(depth_views(geometry, given), measured));
  }
  return estimates;
}

}  // namespace

const std::vector<std::string>& scale_evidence_names() {
  static const std::vector<std::string> names{"camera_poses", "photographs", "sparse_points", "source_depth"};
  return names;
}

std::vector<std::string> usual_scale_evidence() { return {"camera_poses", "photographs", "sparse_points"}; }

ScaleEvidence scale_evidence(const SamplingScene& scene, const std::vector<std::string>& kinds) {
  const auto named = [&](const char* kind) {
    return std::find(kinds.begin(), kinds.end(), kind) != kinds.end();
  };
  ScaleEvidence evidence;
  evidence.camera_poses = named("camera_poses");
  if (named("photographs")) evidence.photographs = stacked(scene.source_images);
  if (named("sparse_points")) evidence.points_in_world = scene.points_in_world;
  if (named("source_depth")) evidence.source_depth = scene.source_depths;
  return evidence;
}

Similarity GeometryPlacement::scene_from_model() const {
  if (!alignment) return {};
  Similarity scene_from_model = alignment->b_from_a;
  // The scale that was taken, or the model's own unit, keeps the middle of the cameras where the alignment puts it.
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const Camera& camera : predicted) {
    middle += camera.world_from_camera.translation() / static_cast<double>(predicted.size());
  }
  const double taken = scale ? scale->scale : 1;
  scene_from_model.translation += (scene_from_model.scale - taken) * (scene_from_model.rotation * middle);
  scene_from_model.scale = taken;
  return scene_from_model;
}

GeometryPlacement place_geometry(const GeometryOutput& geometry, const std::vector<Camera>& given,
                                 const ScaleEvidence& evidence) {
  GeometryPlacement placement;
  try {
    placement.predicted = predicted_cameras(geometry, given);
    placement.alignment = align_poses(placement.predicted, given);
    const auto estimate = depth_scale_from_poses(*placement.alignment);
    if (estimate && evidence.camera_poses) placement.estimates.push_back(*estimate);
  } catch (const Error& error) {
    placement.problem = error.what();
  }
  if (geometry.depth.defined()) {
    for (const DepthScale& estimate : estimates_from_depth(geometry, given, evidence)) {
      placement.estimates.push_back(estimate);
    }
  }
  placement.scale = combined_depth_scale(placement.estimates);
  return placement;
}

nlohmann::ordered_json depth_scale_json(const DepthScale& estimate) {
  nlohmann::ordered_json json{{"estimator", estimate.estimator},
                              {"scale", estimate.scale},
                              {"interval", {estimate.low, estimate.high}},
                              {"residual", estimate.residual}};
  const std::string doubt = doubt_about(estimate);
  if (!doubt.empty()) json["doubt"] = doubt;
  return json;
}

nlohmann::ordered_json estimates_json(const std::vector<DepthScale>& estimates) {
  auto list = nlohmann::ordered_json::array();
  for (const DepthScale& estimate : estimates) list.push_back(depth_scale_json(estimate));
  return list;
}

std::string estimates_text(const std::vector<DepthScale>& estimates) {
  std::string text;
  for (const DepthScale& estimate : estimates) {
    const std::string doubt = doubt_about(estimate);
    text += fmt::format("{}{} says {:.3g}{}", text.empty() ? "" : "; ", estimate.estimator, estimate.scale,
                        doubt.empty() ? "" : ", but " + doubt);
  }
  return text.empty() ? "nothing tells it" : text;
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
