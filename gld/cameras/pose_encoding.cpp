#include "gld/cameras/pose_encoding.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>

namespace gld {
namespace {

constexpr double kLeastTangent = 1e-6;

}  // namespace

PoseEncoding pose_encoding(const Camera& camera) {
  const Eigen::Vector3d centre = camera.world_from_camera.translation();
  Eigen::Quaterniond turn(camera.world_from_camera.linear());
  turn.normalize();
  // q and -q are the same rotation; of the two, networks know the one with w >= 0.
  if (turn.w() < 0) turn.coeffs() = -turn.coeffs();
  const double vertical = 2 * std::atan(static_cast<double>(camera.height) / 2 / camera.intrinsics(1, 1));
  const double horizontal = 2 * std::atan(static_cast<double>(camera.width) / 2 / camera.intrinsics(0, 0));
  return {centre.x(), centre.y(), centre.z(), turn.x(), turn.y(), turn.z(), turn.w(), vertical, horizontal};
}

Camera camera_of_pose_encoding(const PoseEncoding& encoding, const ImageSize& size) {
  const Eigen::Quaterniond turn(encoding[6], encoding[3], encoding[4], encoding[5]);
  const bool finite =
      std::all_of(encoding.begin(), encoding.end(), [](double value) { return std::isfinite(value); });
  if (!finite || !(turn.norm() > 0)) {
    fail({"pose encoding", "nine finite numbers with a quaternion that is not 0",
          finite ? "the quaternion 0" : "NaN or infinity", "check the model's weights with gld inspect"});
  }
  Camera camera;
  camera.width = size.width;
  camera.height = size.height;
  camera.world_from_camera.linear() = turn.normalized().toRotationMatrix();
  camera.world_from_camera.translation() = Eigen::Vector3d(encoding[0], encoding[1], encoding[2]);
  const auto focal_length = [](int64_t side, double field_of_view) {
    return static_cast<double>(side) / 2 / std::max(std::tan(field_of_view / 2), kLeastTangent);
  };
  camera.intrinsics(0, 0) = focal_length(size.width, encoding[8]);
  camera.intrinsics(1, 1) = focal_length(size.height, encoding[7]);
  camera.intrinsics(0, 2) = static_cast<double>(size.width) / 2;
  camera.intrinsics(1, 2) = static_cast<double>(size.height) / 2;
  return camera;
}

}  // namespace gld
