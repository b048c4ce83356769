#pragma once

#include "gld/cameras/camera.h"

#include <string>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace gld {

// Every reader does this at its door. where names the file and the frame in errors.

// Makes a finite rigid motion of a 4x4 matrix. Rotations that are off by rounding (up to 1e-2, as in text files with
// few digits) are made exact; anything else is an Error that says what is wrong: not finite, mirrored, scaled, or a
// last row other than 0 0 0 1.
Eigen::Isometry3d checked_pose(const Eigen::Matrix4d& matrix, const std::string& where);

// The same for a unit quaternion and a translation; a quaternion of norm 0 is an Error, others are normalised.
struct QuaternionPose {
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
};
Eigen::Isometry3d checked_pose(const QuaternionPose& pose, const std::string& where);

// Requires finite, positive focal lengths, zero skew, last row 0 0 1; in pixels, not divided by the image size; and a
// principal point that lies in the image or near it.
void check_frame_camera(const Camera& camera, const std::string& where);

Eigen::Matrix3d intrinsic_matrix(double fx, double fy, double cx, double cy);

// OpenGL cameras look along -z with y up; OpenCV ones along +z with y down.
Eigen::Isometry3d opencv_from_opengl_pose(const Eigen::Isometry3d& world_from_opengl_camera);

}  // namespace gld
