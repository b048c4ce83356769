#pragma once

#include "gld/cameras/camera.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace gld {

// What a set of cameras looks at.
struct LookAtPoint {
  Eigen::Vector3d x_in_world = Eigen::Vector3d::Zero();
  bool from_axes = false;  // false: the axes are parallel or meet behind a camera, and a distance was assumed
};

// Returns the point nearest to all optical axes (least squares of the distances). Where the axes determine none, it is
// the point at fallback_distance along the mean axis; where that is 0, at three times the largest distance between two
// cameras, or 1 when they all stand at one place.
LookAtPoint look_at_point(const std::vector<Camera>& cameras, double fallback_distance);

// What is known of a scene beside its source cameras.
struct PathSurroundings {
  std::vector<Camera> cameras;  // of all its frames; may be empty
  double typical_depth = 0;     // of what the sources see, in the unit of the poses; 0 where it is not known
};

// What an orbit around the sources' scene turns about, and how that was found, in words: the point nearest to the axes
// of all cameras (least absolute distances, so that cameras that look elsewhere do not move it), or to those of the
// sources; either only where it lies in front of every source and at 1/3 to 3 times the typical depth, where that is
// known. Else a point on the sources' mean axis, at the typical depth or at an assumed one.
struct OrbitCentre {
  Eigen::Vector3d x_in_world = Eigen::Vector3d::Zero();
  std::string found_by;
};
OrbitCentre orbit_centre(const std::vector<Camera>& sources, const PathSurroundings& surroundings);

// Returns how far the scene reaches, in the unit of its poses, as far as that is known: the largest of the distances
// between two cameras, of the typical depth and of the point where axes meet. It is 0 where nothing tells it.
double known_reach(const std::vector<Camera>& sources, const PathSurroundings& surroundings);

struct OrbitShape {
  int64_t frames = 6;
  double degrees = 60;  // sweep, centred on the sources; 360 closes the circle without a frame twice
  double fallback_distance = 0;
  std::optional<Eigen::Vector3d> centre;  // else look_at_point of the sources
  double radius = 0;                      // of the circle; 0: the sources' mean distance
};

// Returns cameras on a circle around the vertical axis through the look-at point, each looking exactly at it. Up is the
// mean of the sources' up directions. The circle has the sources' mean distance from the axis (or the shape's radius)
// and mean height; size and intrinsics are the first source's, with the principal point kept.
std::vector<Camera> orbit_cameras(const std::vector<Camera>& sources, const OrbitShape& shape);

// Returns the rotation (columns x, y, z of the camera in the world) that looks along forward with up in the upper half
// of the picture. forward need not have length 1; where it is parallel to up another direction stands in for up.
Eigen::Matrix3d looking_along(const Eigen::Vector3d& forward, const Eigen::Vector3d& up);

}  // namespace gld
