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

// Returns the point with the least sum of weighted squared distances from the axes; nothing where they are parallel.
std::optional<Eigen::Vector3d> where_axes_meet(const std::vector<Camera>& cameras,
                                               const std::vector<double>& weights) {
  const Eigen::Vector3d middle = mean_centre(cameras);
  // The normal equations are around the middle, so that a far origin costs no digits.
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  double sum = 0;
  for (size_t i = 0; i < cameras.size(); ++i) {
    const Eigen::Vector3d z = axis(cameras[i]);
    const Eigen::Matrix3d across = weights[i] * (Eigen::Matrix3d::Identity() - z * z.transpose());
    normal += across;
    right += across * (centre(cameras[i]) - middle);
    sum += weights[i];
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(normal);
  // Axes within about two degrees of each other leave the distance to noise.
  constexpr double kSmallestSpread = 1e-3;
  if (!(eigen.eigenvalues()[0] > kSmallestSpread * sum)) return std::nullopt;
  return middle + normal.ldlt().solve(right);
}

// This takes the least absolute distances instead of squares, by reweighting.
std::optional<Eigen::Vector3d> where_most_axes_meet(const std::vector<Camera>& cameras) {
  if (cameras.empty()) return std::nullopt;
  std::vector<double> weights(cameras.size(), 1.0);
  auto point = where_axes_meet(cameras, weights);
  const double small = 1e-3 * largest_baseline(cameras);
  for (int iteration = 0; point && iteration < 20; ++iteration) {
    for (size_t i = 0; i < cameras.size(); ++i) {
      const Eigen::Vector3d from_centre = *point - centre(cameras[i]);
      const double distance = (from_centre - axis(cameras[i]) * axis(cameras[i]).dot(from_centre)).norm();
      weights[i] = 1 / std::max(distance, std::max(small, 1e-30));
    }
    const double largest = *std::max_element(weights.begin(), weights.end());
    for (double& weight : weights) weight /= largest;
    point = where_axes_meet(cameras, weights);
  }
  return point;
}

// Returns whether the point is in front of every source, and about as far as what they see.
bool is_seen(const Eigen::Vector3d& point, const std::vector<Camera>& sources, double typical_depth) {
  constexpr double kLargestFactor = 3;
  return std::all_of(sources.begin(), sources.end(), [&](const Camera& camera) {
    const double depth = axis(camera).dot(point - centre(camera));
    return depth > 0 && (typical_depth <= 0 ||
                         (depth < kLargestFactor * typical_depth && depth > typical_depth / kLargestFactor));
  });
}

}  // namespace

OrbitCentre orbit_centre(const std::vector<Camera>& sources, const PathSurroundings& surroundings) {
  const double depth = surroundings.typical_depth;
  if (surroundings.cameras.size() > sources.size()) {
    const auto point = where_most_axes_meet(surroundings.cameras);
    if (point && is_seen(*point, sources, depth)) {
      return {*point,
              "where the axes of all " + std::to_string(surroundings.cameras.size()) + " cameras meet"};
    }
  }
  const auto point = where_axes_meet(sources, std::vector<double>(sources.size(), 1.0));
  if (point && is_seen(*point, sources, depth)) return {*point, "where the axes of the source cameras meet"};
  const double baseline = largest_baseline(sources);
  const double distance = depth > 0 ? depth : baseline > 0 ? 3 * baseline : 1;
  return {mean_centre(sources) + distance * mean_direction(sources, 2, 1),
          depth > 0 ? "at the depth of what the source cameras see"
                    : "at an assumed distance, because no axes meet in front of the source cameras"};
}

double known_reach(const std::vector<Camera>& sources, const PathSurroundings& surroundings) {
  std::vector<Camera> cameras = surroundings.cameras;
  cameras.insert(cameras.end(), sources.begin(), sources.end());
  const double reach = std::max(surroundings.typical_depth, largest_baseline(cameras));
  if (reach == 0) return 0;  // what axes of one place meet at is that place, or assumed
  const OrbitCentre centre = orbit_centre(sources, surroundings);
  return std::max(reach, (centre.x_in_world - mean_centre(sources)).norm());
}

LookAtPoint look_at_point(const std::vector<Camera>& cameras, double fallback_distance) {
  const Eigen::Vector3d middle = mean_centre(cameras);
  LookAtPoint point;
  if (const auto meeting = where_axes_meet(cameras, std::vector<double>(cameras.size(), 1.0))) {
    point.x_in_world = *meeting;
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
  const Eigen::Vector3d target =
      shape.centre ? *shape.centre : look_at_point(sources, shape.fallback_distance).x_in_world;
  const Eigen::Vector3d up = mean_direction(sources, 1, -1);
  const Eigen::Vector3d to_middle = mean_centre(sources) - target;
  Eigen::Vector3d outwards = to_middle - up * up.dot(to_middle);
  // Where sources stand straight above the point or all around it, the circle starts where the first one stands, or
  // looks from.
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
  if (shape.radius > 0) {
    height *= radius > 0 ? shape.radius / radius : 1;  // the same elevation
    radius = shape.radius;
  }
  // A camera that stands where it should look at has no direction.
  if (std::hypot(radius, height) <= 1e-9 * std::max(1e-30, target.norm())) {
    fail({"--orbit-center", "a point away from the source cameras", "their own place",
          "choose one in front of them, or add --orbit-radius"});
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
