#include "gld/cameras/pose_alignment.h"

#include "gld/base/error.h"
#include "gld/cameras/angles.h"
#include "gld/cameras/nearest_rotation.h"

#include <cmath>
#include <string>

#include <Eigen/Geometry>

namespace gld {
namespace {

Eigen::Vector3d centre(const Camera& camera) { return camera.world_from_camera.translation(); }

Eigen::Vector3d mean_centre(const std::vector<Camera>& cameras) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const Camera& camera : cameras) sum += centre(camera);
  return sum / static_cast<double>(cameras.size());
}

// Returns the rotation nearest to the mean of b_i a_i^T.
Eigen::Matrix3d mean_rotation(const std::vector<Camera>& in_a, const std::vector<Camera>& in_b) {
  Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
  for (size_t i = 0; i < in_a.size(); ++i) {
    sum += in_b[i].world_from_camera.linear() * in_a[i].world_from_camera.linear().transpose();
  }
  return nearest_rotation(sum);
}

}  // namespace

double rotation_angle(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b) {
  const Eigen::Quaterniond between(Eigen::Matrix3d(a.transpose() * b));
  return 2 * std::atan2(between.vec().norm(), std::abs(between.w())) * kDegreesPerRadian;
}

PoseAlignment align_poses(const std::vector<Camera>& in_a, const std::vector<Camera>& in_b) {
  if (in_a.empty() || in_a.size() != in_b.size()) {
    fail({"pose alignment", "the same cameras twice",
          std::to_string(in_a.size()) + " and " + std::to_string(in_b.size()) + " cameras",
          "check the views"});
  }
  PoseAlignment alignment;
  Similarity& b_from_a = alignment.b_from_a;
  b_from_a.rotation = mean_rotation(in_a, in_b);
  const Eigen::Vector3d mean_a = mean_centre(in_a);
  const Eigen::Vector3d mean_b = mean_centre(in_b);
  double product = 0;
  double square_a = 0;
  double square_b = 0;
  for (size_t i = 0; i < in_a.size(); ++i) {
    const Eigen::Vector3d a = b_from_a.rotation * (centre(in_a[i]) - mean_a);
    const Eigen::Vector3d b = centre(in_b[i]) - mean_b;
    product += a.dot(b);
    square_a += a.squaredNorm();
    square_b += b.squaredNorm();
  }
  // Baselines that are rounding of the centres' own size say nothing.
  const double noise_a = 1e-7 * (mean_a.norm() + std::sqrt(square_a));
  const double noise_b = 1e-12 * (mean_b.norm() + std::sqrt(square_b));
  if (std::sqrt(square_a) > noise_a && std::sqrt(square_b) > noise_b && product > 0) {
    alignment.scale_known = true;
    b_from_a.scale = product / square_a;
  }
  b_from_a.translation = mean_b - b_from_a.scale * (b_from_a.rotation * mean_a);
  double square_error = 0;
  for (size_t i = 0; i < in_a.size(); ++i) {
    square_error += (b_from_a * centre(in_a[i]) - centre(in_b[i])).squaredNorm();
    alignment.rotation_error += rotation_angle(b_from_a.rotation * in_a[i].world_from_camera.linear(),
                                               in_b[i].world_from_camera.linear()) /
                                static_cast<double>(in_a.size());
  }
  const auto count = static_cast<double>(in_a.size());
  alignment.centre_error = std::sqrt(square_error / count);
  alignment.spread = std::sqrt(square_b / count);
  // Three coordinates a centre, less the translation's three and the scale; the rotation comes from the orientations.
  if (alignment.scale_known) alignment.scale_deviation = std::sqrt(square_error / (3 * count - 4) / square_a);
  return alignment;
}

}  // namespace gld
