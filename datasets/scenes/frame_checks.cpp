#include "datasets/scenes/frame_checks.h"

#include "datasets/images/decoded_pixels.h"
#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <sstream>

#include <Eigen/LU>
#include <Eigen/SVD>
#include <fmt/format.h>

namespace gld {
namespace {

constexpr double kRotationTolerance = 1e-2;

std::string number(double value) {
  std::ostringstream text;
  text << value;
  return text.str();
}

std::string numbers(const Eigen::RowVectorXd& values) {
  std::string text;
  for (double value : values) text += (text.empty() ? "" : " ") + number(value);
  return text;
}

}  // namespace

Eigen::Isometry3d checked_pose(const Eigen::Matrix4d& matrix, const std::string& where) {
  if (!matrix.allFinite()) {
    fail({where, "a finite pose", "a value that is not a number or infinite", "leave the frame out"});
  }
  if ((matrix.row(3) - Eigen::RowVector4d(0, 0, 0, 1)).cwiseAbs().maxCoeff() > 1e-6) {
    fail({where, "a pose with the last row 0 0 0 1", numbers(matrix.row(3)), "check the matrix"});
  }
  const Eigen::Matrix3d linear = matrix.topLeftCorner<3, 3>();
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(linear, Eigen::ComputeFullU | Eigen::ComputeFullV);
  // NOLINTNEXTLINE(performance-unnecessary-copy-initialization): g++ 12 takes a reference's for uninitialised
  const Eigen::Vector3d stretch = svd.singularValues();
  if ((stretch.array() - 1).abs().maxCoeff() > kRotationTolerance) {
    fail({where, "a pose with a rotation (axes of length 1)",
          "axes stretched by " + numbers(stretch.transpose()), "check the matrix"});
  }
  if (linear.determinant() < 0) {
    fail({where, "a pose with a rotation", "a mirroring (determinant -1)", "check the axis convention"});
  }
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  // Poses that are exact to double precision stay as they are, bit for bit.
  const bool exact = (stretch.array() - 1).abs().maxCoeff() < 1e-12;
  pose.linear() = exact ? linear : Eigen::Matrix3d(svd.matrixU() * svd.matrixV().transpose());
  pose.translation() = matrix.topRightCorner<3, 1>();
  return pose;
}

Eigen::Isometry3d checked_pose(const QuaternionPose& pose, const std::string& where) {
  if (!pose.rotation.coeffs().allFinite() || !pose.translation.allFinite()) {
    fail({where, "a finite pose", "a value that is not a number or infinite", "leave the frame out"});
  }
  const double norm = pose.rotation.norm();
  if (std::abs(norm - 1) > kRotationTolerance) {
    fail({where, "a quaternion of length 1", "one of length " + number(norm),
          "check the order of the columns"});
  }
  Eigen::Isometry3d result = Eigen::Isometry3d::Identity();
  result.linear() = pose.rotation.normalized().toRotationMatrix();
  result.translation() = pose.translation;
  return result;
}

void check_frame_camera(const Camera& camera, const std::string& where) {
  if (camera.width < 2 || camera.height < 2) {
    fail({where, "an image at least 2 pixels wide and high",
          std::to_string(camera.width) + "x" + std::to_string(camera.height), "check the camera's size"});
  }
  check_picture_size(camera.width, camera.height, where);
  constexpr int64_t kLongest =
      32;  // of the other side: resized to fill a trained size, a line of pixels would take gigabytes
  if (std::max(camera.width, camera.height) > kLongest * std::min(camera.width, camera.height)) {
    fail({where, fmt::format("a picture at most {} times as long as wide", kLongest),
          std::to_string(camera.width) + "x" + std::to_string(camera.height), "cut it"});
  }
  // Beyond these, single precision gives depths of 0 or infinity without a word.
  constexpr double kFarthest = 1e12, kLongestFocal = 1e6;
  const double far = camera.world_from_camera.translation().cwiseAbs().maxCoeff();
  if (!(far <= kFarthest)) {
    fail({where, "a camera within " + number(kFarthest) + " units of the origin", "one at " + number(far),
          "check the unit of the poses"});
  }
  const Eigen::Matrix3d& k = camera.intrinsics;
  if (!k.allFinite()) {
    fail({where, "finite intrinsics", "a value that is not a number or infinite", "leave the frame out"});
  }
  if (k(0, 0) <= 0 || k(1, 1) <= 0) {
    fail({where, "positive focal lengths", "fx " + number(k(0, 0)) + " and fy " + number(k(1, 1)),
          "check the intrinsics"});
  }
  if (std::abs(k(0, 1)) > 1e-6 * k(0, 0) || k(1, 0) != 0 || k(2, 0) != 0 || k(2, 1) != 0 ||
      std::abs(k(2, 2) - 1) > 1e-9) {
    fail({where, "intrinsics fx 0 cx; 0 fy cy; 0 0 1",
          numbers(k.row(0)) + "; " + numbers(k.row(1)) + "; " + numbers(k.row(2)), "remove the skew"});
  }
  const double width = static_cast<double>(camera.width);
  const double height = static_cast<double>(camera.height);
  if (k(0, 0) > kLongestFocal * width || k(1, 1) > kLongestFocal * height) {
    fail({where, "focal lengths up to a million times the image's sides",
          "fx " + number(k(0, 0)) + " and fy " + number(k(1, 1)), "check the intrinsics"});
  }
  // A focal length under a twentieth of the width would be a field of view of 168 degrees.
  if (k(0, 0) < 0.05 * width && k(0, 2) <= 1.5 && k(1, 2) <= 1.5) {
    fail({where, "intrinsics in pixels",
          "fx " + number(k(0, 0)) + ", cx " + number(k(0, 2)) + " for an image " +
              std::to_string(camera.width) + " pixels wide, which look divided by the image size",
          "multiply fx and cx by the width, fy and cy by the height"});
  }
  if (k(0, 2) < -width || k(0, 2) > 2 * width || k(1, 2) < -height || k(1, 2) > 2 * height) {
    fail({where, "a principal point in or near the image",
          "cx " + number(k(0, 2)) + " and cy " + number(k(1, 2)) + " for " + std::to_string(camera.width) +
              "x" + std::to_string(camera.height),
          "check that the intrinsics belong to this image size"});
  }
}

Eigen::Matrix3d intrinsic_matrix(double fx, double fy, double cx, double cy) {
  Eigen::Matrix3d k = Eigen::Matrix3d::Identity();
  k(0, 0) = fx;
  k(1, 1) = fy;
  k(0, 2) = cx;
  k(1, 2) = cy;
  return k;
}

Eigen::Isometry3d opencv_from_opengl_pose(const Eigen::Isometry3d& world_from_opengl_camera) {
  Eigen::Isometry3d pose = world_from_opengl_camera;
  pose.linear().col(1) *= -1;
  pose.linear().col(2) *= -1;
  return pose;
}

}  // namespace gld
