#pragma once

#include "gld/cameras/camera.h"

#include <vector>

#include <Eigen/Core>

namespace gld {

// x_in_b = scale * rotation * x_in_a + translation.
struct Similarity {
  double scale = 1;
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  Eigen::Vector3d operator*(const Eigen::Vector3d& x_in_a) const {
    return scale * (rotation * x_in_a) + translation;
  }
};

struct PoseAlignment {
  Similarity b_from_a;
  // False says that the cameras stand at one place in a or b (or contradict), and scale is 1. True says only that there
  // is a scale that fits best; how well it explains the cameras is for gld/photogrammetry/depth_scale.h to judge.
  bool scale_known = false;
  double scale_deviation = 0;  // standard error of the scale by what is left between the centres
  double rotation_error = 0;   // mean angle left between the cameras, degrees
  double centre_error = 0;     // root mean square distance left between the centres, in b
  double spread = 0;           // root mean square distance of the centres from their mean, in b
};

// Returns the similarity that maps the cameras of frame a (such as those recovered from rays) onto the same cameras in
// frame b (the world). The rotation is the mean of the cameras' own rotations and not fitted to the centres, because
// centres along a line leave it open. Its scale is one estimate of the length of the rays' unit
// (gld/photogrammetry/depth_scale.h). Throws Error unless both have the same number of cameras, at least one.
PoseAlignment align_poses(const std::vector<Camera>& in_a, const std::vector<Camera>& in_b);

// Returns the angle of the rotation between two orientations, in degrees, exact also near 0.
double rotation_angle(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b);

}  // namespace gld
