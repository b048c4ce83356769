#pragma once

#include "gld/cameras/camera.h"

#include <cstdint>
#include <vector>

#include <Eigen/Core>

namespace gld {

// What a set of cameras looks at.
struct LookAtPoint {
  Eigen::Vector3d x_in_world = Eigen::Vector3d::Zero();
  bool from_axes = false;  // false: the axes are parallel or meet behind a camera, and a distance was assumed
};

// The point nearest to all optical axes (least squares of the distances). Where the axes determine none, the point at
// fallback_distance along the mean axis; where that is 0, at three times the largest distance between two cameras, or
// 1 when they all stand at one place.
LookAtPoint look_at_point(const std::vector<Camera>& cameras, double fallback_distance);

struct OrbitShape {
  int64_t frames = 6;
  double degrees = 60;  // sweep, centred on the sources; 360 closes the circle without a frame twice
  double fallback_distance = 0;
};

// Cameras on a circle around the vertical axis through the look-at point, each looking exactly at it. Up is the mean
// of the sources' up directions. The circle has the sources' mean distance from the axis and mean height; size and
// intrinsics are the first source's, with the principal point kept.
std::vector<Camera> orbit_cameras(const std::vector<Camera>& sources, const OrbitShape& shape);

// The rotation (columns x, y, z of the camera in the world) that looks along forward with up in the upper half of the
// picture. forward need not have length 1; where it is parallel to up another direction stands in for up.
Eigen::Matrix3d looking_along(const Eigen::Vector3d& forward, const Eigen::Vector3d& up);

}  // namespace gld
