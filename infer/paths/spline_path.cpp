#include "infer/paths/spline_path.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <string>

#include <Eigen/Geometry>

namespace gld {
namespace {

// Returns the logarithm of a unit quaternion with a non-negative real part, as half the rotation vector.
Eigen::Vector3d half_rotation_vector(const Eigen::Quaterniond& rotation) {
  const double sine = rotation.vec().norm();
  if (sine < 1e-12) return rotation.vec();
  return rotation.vec() / sine * std::atan2(sine, rotation.w());
}

Eigen::Quaterniond from_half_rotation_vector(const Eigen::Vector3d& half) {
  const double angle = half.norm();
  Eigen::Quaterniond rotation;
  rotation.w() = std::cos(angle);
  rotation.vec() = angle < 1e-12 ? half : Eigen::Vector3d(half / angle * std::sin(angle));
  return rotation.normalized();
}

// Returns the cameras' rotations with signs such that neighbours lie in one half sphere: q and -q are the same
// rotation, but interpolation between them is not.
std::vector<Eigen::Quaterniond> aligned_rotations(const std::vector<Camera>& cameras) {
  std::vector<Eigen::Quaterniond> rotations;
  for (const Camera& camera : cameras) {
    Eigen::Quaterniond rotation(camera.world_from_camera.linear());
    rotation.normalize();
    if (!rotations.empty() && rotations.back().dot(rotation) < 0) rotation.coeffs() *= -1;
    rotations.push_back(rotation);
  }
  return rotations;
}

// Returns Shoemake's inner control point of rotation i; at the ends it is the rotation itself.
Eigen::Quaterniond inner_control(const std::vector<Eigen::Quaterniond>& rotations, size_t i) {
  if (i == 0 || i + 1 == rotations.size()) return rotations[i];
  const Eigen::Quaterniond back = rotations[i].conjugate() * rotations[i - 1];
  const Eigen::Quaterniond forth = rotations[i].conjugate() * rotations[i + 1];
  return rotations[i] *
         from_half_rotation_vector(-0.25 * (half_rotation_vector(back) + half_rotation_vector(forth)));
}

// Without the choice of the shorter way that Eigen's slerp makes: inside squad it would make the path jump.
Eigen::Quaterniond slerp(const Eigen::Quaterniond& a, const Eigen::Quaterniond& b, double fraction) {
  const double cosine = std::clamp(a.dot(b), -1.0, 1.0);
  const double angle = std::acos(cosine);
  Eigen::Quaterniond result;
  if (std::sin(angle) < 1e-9) {
    result.coeffs() = (1 - fraction) * a.coeffs() + fraction * b.coeffs();
    return result.normalized();
  }
  result.coeffs() =
      (std::sin((1 - fraction) * angle) * a.coeffs() + std::sin(fraction * angle) * b.coeffs()) /
      std::sin(angle);
  return result.normalized();
}

Eigen::Matrix3d rotation_at(const std::vector<Camera>& cameras, size_t segment, double fraction) {
  const std::vector<Eigen::Quaterniond> rotations = aligned_rotations(cameras);
  const Eigen::Quaterniond outer = slerp(rotations[segment], rotations[segment + 1], fraction);
  const Eigen::Quaterniond inner =
      slerp(inner_control(rotations, segment), inner_control(rotations, segment + 1), fraction);
  return slerp(outer, inner, 2 * fraction * (1 - fraction)).toRotationMatrix();
}

// Places are relative to the first camera, so that a far origin costs no digits. Beyond the ends the path goes on as
// straight as its end segments.
Eigen::Vector3d centre_at(const std::vector<Camera>& cameras, size_t segment, double fraction) {
  const Eigen::Vector3d origin = cameras.front().world_from_camera.translation();
  const auto point = [&](size_t i) {
    return Eigen::Vector3d(cameras[i].world_from_camera.translation() - origin);
  };
  const Eigen::Vector3d p1 = point(segment);
  const Eigen::Vector3d p2 = point(segment + 1);
  const Eigen::Vector3d p0 = segment == 0 ? Eigen::Vector3d(2 * p1 - p2) : point(segment - 1);
  const Eigen::Vector3d p3 =
      segment + 2 == cameras.size() ? Eigen::Vector3d(2 * p2 - p1) : point(segment + 2);
  const double f = fraction;
  return origin + 0.5 * (2 * p1 + f * (p2 - p0) + f * f * (2 * p0 - 5 * p1 + 4 * p2 - p3) +
                         f * f * f * (3 * (p1 - p2) + p3 - p0));
}

// Returns fx, fy, cx, cy in pixels of a picture of the first camera's size.
Eigen::Vector4d intrinsics_of(const Camera& camera, const Camera& first) {
  const double sx = static_cast<double>(first.width) / static_cast<double>(camera.width);
  const double sy = static_cast<double>(first.height) / static_cast<double>(camera.height);
  const Eigen::Matrix3d& k = camera.intrinsics;
  return {k(0, 0) * sx, k(1, 1) * sy, k(0, 2) * sx, k(1, 2) * sy};
}

}  // namespace

Camera spline_camera(const std::vector<Camera>& cameras, double position) {
  if (cameras.size() < 2) {
    fail({"--path spline", "at least two source cameras", std::to_string(cameras.size()),
          "add sources or use --path orbit"});
  }
  const double last = static_cast<double>(cameras.size() - 1);
  const double inside = std::clamp(position, 0.0, last);
  const auto segment = static_cast<size_t>(std::min(std::floor(inside), last - 1));
  const double fraction = inside - static_cast<double>(segment);
  const Eigen::Vector4d from = intrinsics_of(cameras[segment], cameras.front());
  const Eigen::Vector4d to = intrinsics_of(cameras[segment + 1], cameras.front());
  Camera camera = cameras.front();
  for (int i = 0; i < 2; ++i) {
    camera.intrinsics(i, i) = std::pow(from[i], 1 - fraction) * std::pow(to[i], fraction);
    camera.intrinsics(i, 2) = (1 - fraction) * from[2 + i] + fraction * to[2 + i];
  }
  camera.world_from_camera.linear() = rotation_at(cameras, segment, fraction);
  camera.world_from_camera.translation() = centre_at(cameras, segment, fraction);
  return camera;
}

std::vector<double> positions_between(int64_t cameras, int64_t frames) {
  const double last = static_cast<double>(cameras - 1);
  // The middle of the path, or of the stretch before it where a camera stands there.
  if (frames == 1) return {cameras % 2 == 0 ? last / 2 : std::max(last / 2 - 0.5, 0.0)};
  // Both ends are left out by some of the path, at most by what lies between two frames then. Of several such margins
  // those are taken that keep all frames farthest from the given cameras, and the largest of these.
  constexpr int kMargins = 20;
  const auto margin = [&](int step) { return step / static_cast<double>(kMargins * (frames + 1)); };
  std::vector<double> best;
  double farthest = -1;
  for (int before = kMargins; before >= kMargins / 4; --before) {
    for (int after = kMargins; after >= kMargins / 4; --after) {
      const double stretch = (1 - margin(before) - margin(after)) / static_cast<double>(frames - 1);
      std::vector<double> positions;
      double nearest = 1;
      for (int64_t i = 0; i < frames; ++i) {
        const double position = last * (margin(before) + stretch * static_cast<double>(i));
        positions.push_back(position);
        nearest = std::min(nearest, std::abs(position - std::round(position)));
      }
      if (nearest <= farthest + 1e-9) continue;
      farthest = nearest;
      best = std::move(positions);
    }
  }
  return best;
}

std::vector<Camera> spline_cameras(const std::vector<Camera>& cameras, int64_t frames) {
  std::vector<Camera> path;
  for (const double position : positions_between(static_cast<int64_t>(cameras.size()), frames))
    path.push_back(spline_camera(cameras, position));
  return path;
}

}  // namespace gld
