#include "infer/paths/orbit_path.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>

namespace gld {
namespace {

constexpr double kPi = 3.14159265358979323846;

Eigen::Vector3d centre(const Camera& camera) { return camera.world_from_camera.translation(); }
Eigen::Vector3d axis(const Camera& camera) { return camera.world_from_camera.linear().col(2); }

Eigen::Vector3d mean_centre(const std::vector<Camera>& cameras) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const Camera& camera : cameras) sum += centre(camera);
  return sum / static_cast<double>(cameras.size());
}

// The first camera's direction stands in for a mean that vanishes.
Eigen::Vector3d mean_direction(const std::vector<Camera>& cameras, int column, double sign) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const Camera& camera : cameras) sum += sign * camera.world_from_camera.linear().col(column);
  if (sum.norm() < 1e-6 * static_cast<double>(cameras.size())) {
    sum = sign * cameras.front().world_from_camera.linear().col(column);
  }
  return sum.normalized();
}

double largest_baseline(const std::vector<Camera>& cameras) {
  double largest = 0;
  for (const Camera& a : cameras) {
    for (const Camera& b : cameras) largest = std::max(largest, (centre(a) - centre(b)).norm());
  }
  return largest;
}

}  // namespace

LookAtPoint look_at_point(const std::vector<Camera>& cameras, double fallback_distance) {
  const Eigen::Vector3d middle = mean_centre(cameras);
  // Normal equations around the middle, so that a far origin costs no digits.
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  for (const Camera& camera : cameras) {
    const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - axis(camera) * axis(camera).transpose();
    normal += across;
    right += across * (centre(camera) - middle);
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(normal);
  LookAtPoint point;
  // Axes within about two degrees of each other leave the distance to noise.
  constexpr double kSmallestSpread = 1e-3;
  if (eigen.eigenvalues()[0] > kSmallestSpread * static_cast<double>(cameras.size())) {
    point.x_in_world = middle + normal.ldlt().solve(right);
    point.from_axes = std::all_of(cameras.begin(), cameras.end(), [&](const Camera& camera) {
      return axis(camera).dot(point.x_in_world - centre(camera)) > 0;
    });
  }
  if (!point.from_axes) {
    const double baseline = largest_baseline(cameras);
    const double assumed = baseline > 0 ? 3 * baseline : 1;
    point.x_in_world =
        middle + mean_direction(cameras, 2, 1) * (fallback_distance > 0 ? fallback_distance : assumed);
  }
  return point;
}

Eigen::Matrix3d looking_along(const Eigen::Vector3d& forward, const Eigen::Vector3d& up) {
  const Eigen::Vector3d z = forward.normalized();
  Eigen::Vector3d x = z.cross(up.normalized());
  if (x.norm() < 1e-9) x = z.unitOrthogonal();
  Eigen::Matrix3d rotation;
  rotation.col(2) = z;
  rotation.col(0) = x.normalized();
  rotation.col(1) = z.cross(rotation.col(0));
  return rotation;
}

std::vector<Camera> orbit_cameras(const std::vector<Camera>& sources, const OrbitShape& shape) {
  if (sources.empty()) fail({"orbit", "at least one source camera", "none", "name the sources"});
  const Eigen::Vector3d target = look_at_point(sources, shape.fallback_distance).x_in_world;
  const Eigen::Vector3d up = mean_direction(sources, 1, -1);
  const Eigen::Vector3d to_middle = mean_centre(sources) - target;
  Eigen::Vector3d outwards = to_middle - up * up.dot(to_middle);
  // Sources straight above the point or all around it: start where the first one stands, or looks from.
  if (outwards.norm() < 1e-3 * to_middle.norm() || to_middle.norm() < 1e-12) {
    const Eigen::Vector3d first = centre(sources.front()) - target;
    outwards = first - up * up.dot(first);
    if (outwards.norm() < 1e-9 * std::max(first.norm(), 1e-30)) outwards = up.unitOrthogonal();
  }
  outwards.normalize();
  double radius = 0;
  double height = 0;
  for (const Camera& source : sources) {
    const Eigen::Vector3d from_target = centre(source) - target;
    height += up.dot(from_target) / static_cast<double>(sources.size());
    radius += (from_target - up * up.dot(from_target)).norm() / static_cast<double>(sources.size());
  }
  const bool closed = std::abs(shape.degrees) >= 360;
  std::vector<Camera> cameras;
  for (int64_t i = 0; i < shape.frames; ++i) {
    const double steps = static_cast<double>(closed ? shape.frames : std::max<int64_t>(shape.frames - 1, 1));
    const double start = closed || shape.frames == 1 ? 0 : -0.5;
    const double angle = (start + static_cast<double>(i) / steps) * shape.degrees * kPi / 180;
    const Eigen::Vector3d direction = Eigen::AngleAxisd(angle, up) * outwards;
    Camera camera = sources.front();
    camera.world_from_camera.translation() = target + radius * direction + height * up;
    // Relative to the target, so that a far origin costs no digits.
    camera.world_from_camera.linear() = looking_along(-(radius * direction + height * up), up);
    cameras.push_back(camera);
  }
  return cameras;
}

}  // namespace gld
