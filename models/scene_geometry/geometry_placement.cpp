#include "models/scene_geometry/geometry_placement.h"

#include "gld/base/error.h"
#include "gld/photogrammetry/photo_consistency.h"
#include "gld/photogrammetry/scale_from_known_depth.h"
#include "models/scene_geometry/predicted_cameras.h"

#include <limits>
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
  if (!evidence.matched_depth.empty()) {
    add(scale_from_measured_depth(depth_views(geometry, given), evidence.matched_depth, "photographs"));
  } else if (evidence.photographs.defined() && evidence.photographs.size(0) > 1) {
    add(scale_from_photographs(geometry, given, evidence.photographs));
  }
  if (!evidence.points_in_world.empty()) {
    add(scale_from_sparse_points(depth_views(geometry, given), evidence.points_in_world));
  }
  if (!evidence.source_depth.empty()) {
    add(scale_from_measured_depth(depth_views(geometry, given), evidence.source_depth, "source_depth"));
  }
  if (!evidence.usual_unit_depth.empty()) {
    const auto usual = scale_from_measured_depth(depth_views(geometry, given), evidence.usual_unit_depth,
                                                 kUsualUnitEvidence);
    if (usual) estimates.push_back(with_log_deviation(*usual, evidence.usual_unit_log_deviation));
  }
  return estimates;
}

}  // namespace

std::vector<PlanarDepth> confident_depth(const StereoScene& stereo) {
  // With fewer, and by chance all in one corner, photographs are asked at all scales instead.
  constexpr double kLeastShare = 0.02;
  std::vector<PlanarDepth> result;
  if (stereo.confident_share() < kLeastShare) return result;
  for (const StereoDepth& view : stereo.views) {
    PlanarDepth depth = view.depth;
    for (size_t i = 0; i < depth.values.size(); ++i) {
      if (view.confidence.values[i] < kConfidentStereo)
        depth.values[i] = std::numeric_limits<float>::quiet_NaN();
    }
    result.push_back(std::move(depth));
  }
  return result;
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

}  // namespace gld
