#include "gld/metrics/pose_metrics.h"

#include "gld/base/error.h"
#include "gld/cameras/angles.h"
#include "gld/cameras/pose_alignment.h"
#include "gld/metrics/metric.h"
#include "gld/photogrammetry/pose_from_rays.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace gld {
namespace {

constexpr double kUndefinedAngle = std::numeric_limits<double>::quiet_NaN();

void require_one_of_each(const Views& views, const std::vector<Camera>& predicted,
                         const torch::Tensor& rays) {
  const int64_t count = views.size();
  if (rays.dim() == 4 && rays.size(0) == count && rays.size(3) == 6 && views.num_targets() > 0 &&
      static_cast<int64_t>(predicted.size()) == count) {
    return;
  }
  fail({"pose metrics",
        "a camera and rays (views, rows, columns, 6) of each of " + std::to_string(count) +
            " views, some of them targets",
        std::to_string(predicted.size()) + " cameras and rays of shape " + c10::str(rays.sizes()),
        "predict the rays of all views"});
}

// Returns the cameras as the first one sees them.
std::vector<Eigen::Isometry3d> seen_from_first(const std::vector<Camera>& cameras) {
  const Eigen::Isometry3d first_from_world = cameras.front().camera_from_world();
  std::vector<Eigen::Isometry3d> poses;
  poses.reserve(cameras.size());
  for (const Camera& camera : cameras) poses.push_back(first_from_world * camera.world_from_camera);
  return poses;
}

double angle_between(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b)) * kDegreesPerRadian;
}

double largest_distance(const std::vector<Eigen::Isometry3d>& poses) {
  double largest = 0;
  for (const auto& a : poses) {
    for (const auto& b : poses) {
      largest = std::max(largest, (a.translation() - b.translation()).norm());
    }
  }
  return largest;
}

// Returns argmin over s >= 0 of sum |s predicted - truth|^2 over the centres.
double centre_scale(const std::vector<Eigen::Isometry3d>& predicted,
                    const std::vector<Eigen::Isometry3d>& truth) {
  double product = 0, square = 0;
  for (size_t i = 0; i < truth.size(); ++i) {
    product += predicted[i].translation().dot(truth[i].translation());
    square += predicted[i].translation().squaredNorm();
  }
  return square > 0 ? std::max(0.0, product / square) : 0.0;
}

Eigen::Vector3d vector_at(const float* values) { return Eigen::Vector3f(values).cast<double>(); }

}  // namespace

PoseErrors pose_errors(const Views& views, const std::vector<Camera>& predicted, const torch::Tensor& rays) {
  require_one_of_each(views, predicted, rays);
  const auto true_poses = seen_from_first(views.cameras), poses = seen_from_first(predicted);
  const Eigen::Isometry3d first_from_model = predicted.front().camera_from_world();
  const double baseline = largest_distance(true_poses), scale = centre_scale(poses, true_poses);
  const auto all_rays = rays.to(torch::kCPU, torch::kFloat32).contiguous();
  const int64_t rows = rays.size(1), columns = rays.size(2);

  PoseErrors errors;
  errors.rotation = torch::full({views.num_targets()}, kUndefinedAngle, torch::kFloat64);
  errors.translation_direction = errors.rotation.clone();
  errors.ray_angle = errors.rotation.clone();
  errors.ray_origin = errors.rotation.clone();
  for (int64_t target = 0; target < views.num_targets(); ++target) {
    const auto view = static_cast<size_t>(views.num_sources + target);
    const Eigen::Isometry3d &truth = true_poses[view], &pose = poses[view];
    errors.rotation[target] = rotation_angle(truth.linear(), pose.linear());
    if (truth.translation().norm() > 0 && pose.translation().norm() > 0) {
      errors.translation_direction[target] = angle_between(truth.translation(), pose.translation());
    }
    Camera camera = views.cameras[view];
    camera.world_from_camera = truth;
    const RayMap true_rays = rays_of_camera(camera, columns, rows);
    const float* made = all_rays[views.num_sources + target].data_ptr<float>();
    double angles = 0, distances = 0;
    int64_t count = 0;
    for (int64_t cell = 0; cell < rows * columns; ++cell, made += 6) {
      if (!std::all_of(made, made + 6, [](float value) { return std::isfinite(value); })) continue;
      angles += angle_between(vector_at(true_rays.values.data() + 6 * cell),
                              first_from_model.linear() * vector_at(made));
      distances += (scale * (first_from_model * vector_at(made + 3)) - truth.translation()).norm();
      ++count;
    }
    if (count == 0) continue;
    errors.ray_angle[target] = angles / static_cast<double>(count);
    if (baseline > 0) errors.ray_origin[target] = distances / static_cast<double>(count) / baseline;
  }
  return errors;
}

EstimatedCameraErrors estimated_camera_errors(const std::vector<Camera>& truth,
                                              const std::vector<Camera>& estimated) {
  if (truth.empty() || truth.size() != estimated.size()) {
    fail({"pose metrics", "an estimated camera for each of " + std::to_string(truth.size()) + " views",
          std::to_string(estimated.size()), "estimate all views"});
  }
  const auto true_poses = seen_from_first(truth), poses = seen_from_first(estimated);
  const double baseline = largest_distance(true_poses), scale = centre_scale(poses, true_poses);
  const auto others = static_cast<int64_t>(truth.size()) - 1;
  EstimatedCameraErrors errors;
  errors.rotation = torch::full({others}, kUndefinedAngle, torch::kFloat64);
  errors.translation_direction = errors.rotation.clone();
  errors.centre = errors.rotation.clone();
  for (int64_t i = 0; i < others; ++i) {
    const Eigen::Isometry3d &a = true_poses[static_cast<size_t>(i) + 1],
                            &b = poses[static_cast<size_t>(i) + 1];
    errors.rotation[i] = rotation_angle(a.linear(), b.linear());
    if (a.translation().norm() > 0 && b.translation().norm() > 0) {
      errors.translation_direction[i] = angle_between(a.translation(), b.translation());
    }
    if (baseline > 0) errors.centre[i] = (scale * b.translation() - a.translation()).norm() / baseline;
  }
  return errors;
}

namespace {

template <torch::Tensor EstimatedCameraErrors::*error>
Metric photo_metric(const std::string& name, const std::string& unit, const std::string& without_any) {
  return {name, unit, Better::kLower, {MetricNeed::kPhotoCameras}, [without_any](const MetricInputs& inputs) {
            const auto errors = estimated_camera_errors(inputs.views.cameras, inputs.photo_cameras);
            return metric_of_views(errors.*error, without_any);
          }};
}

template <torch::Tensor PoseErrors::*error>
Metric pose_metric(const std::string& name, const std::string& unit, const std::string& without_any) {
  return {name, unit, Better::kLower, {MetricNeed::kRays}, [without_any](const MetricInputs& inputs) {
            const auto errors = pose_errors(inputs.views, inputs.predicted_cameras, inputs.rays);
            return metric_of_views(errors.*error, without_any);
          }};
}

}  // namespace

std::vector<Metric> pose_metrics() {
  return {
      pose_metric<&PoseErrors::rotation>("rotation_error", "degrees", "no predicted camera is finite"),
      pose_metric<&PoseErrors::translation_direction>("translation_direction_error", "degrees",
                                                      "the cameras, true or predicted, stand at one place"),
      pose_metric<&PoseErrors::ray_angle>("ray_angle_error", "degrees", "no predicted ray is finite"),
      pose_metric<&PoseErrors::ray_origin>("ray_origin_error", "baselines",
                                           "the scene's cameras stand at one place"),
      photo_metric<&EstimatedCameraErrors::rotation>("photo_rotation_error", "degrees", "there is one view"),
      photo_metric<&EstimatedCameraErrors::translation_direction>(
          "photo_translation_direction_error", "degrees",
          "the cameras, true or estimated, stand at one place"),
      photo_metric<&EstimatedCameraErrors::centre>("photo_centre_error", "baselines",
                                                   "the scene's cameras stand at one place")};
}

}  // namespace gld
