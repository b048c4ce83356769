#include "gld/cameras/camera_checks.h"

#include "gld/base/error.h"
#include "gld/cameras/relative_cameras.h"

#include <cmath>

#include <Eigen/LU>
#include <fmt/format.h>

namespace gld {
namespace {

constexpr double kRotationTolerance = 1e-3;

void check_intrinsics(const Camera& camera, const std::string& where) {
  const Eigen::Matrix3d& k = camera.intrinsics;
  if (!k.allFinite()) {
    fail({where, "finite intrinsics", "a number that is not finite", "correct or leave out this camera"});
  }
  if (!(k(0, 0) > 0) || !(k(1, 1) > 0)) {
    fail({where, "positive focal lengths in pixels", fmt::format("fx = {}, fy = {}", k(0, 0), k(1, 1)),
          "give the intrinsics in OpenCV convention (x right, y down, z forward)"});
  }
  // Lenses go from 179.8 degrees to 20 seconds of arc: beyond is no lens, and what it shows would be matched by
  // rounding alone.
  constexpr double kShortestLens = 1e-3, kLongestLens = 1e4;
  for (const double focal_length : {k(0, 0), k(1, 1)}) {
    const double lens = focal_length / static_cast<double>(camera.width);
    if (lens >= kShortestLens && lens <= kLongestLens) continue;
    fail({where, fmt::format("focal lengths of {:g} to {:g} image widths", kShortestLens, kLongestLens),
          fmt::format("{:.3g}", lens), "give the intrinsics in pixels"});
  }
  const double scale = k(0, 0);
  if (std::abs(k(0, 1)) > 1e-6 * scale || k(1, 0) != 0 || k(2, 0) != 0 || k(2, 1) != 0 ||
      std::abs(k(2, 2) - 1.0) > 1e-6) {
    fail({where, "intrinsics of the form fx 0 cx, 0 fy cy, 0 0 1",
          fmt::format("{} {} {}, {} {} {}, {} {} {}", k(0, 0), k(0, 1), k(0, 2), k(1, 0), k(1, 1), k(1, 2),
                      k(2, 0), k(2, 1), k(2, 2)),
          "undistort the images to a pinhole camera without skew"});
  }
}

void check_pose(const Camera& camera, const std::string& where) {
  const Eigen::Matrix4d pose = camera.world_from_camera.matrix();
  if (!pose.allFinite()) {
    fail({where, "a finite camera pose", "a number that is not finite", "correct or leave out this camera"});
  }
  const Eigen::Matrix3d rotation = camera.world_from_camera.linear();
  const double error = (rotation.transpose() * rotation - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (!(error <= kRotationTolerance)) {
    fail({where, "an orthonormal rotation",
          fmt::format("rows and columns that miss unit length or right angles by {:.3g}", error),
          "remove the scale or shear from the pose"});
  }
  if (rotation.determinant() < 0) {
    fail({where, "a right-handed rotation", "a mirrored one (determinant -1)",
          "flip one axis: poses are world-from-camera in OpenCV convention (x right, y down, z forward)"});
  }
}

void warn_about_intrinsics(const Camera& camera, const std::string& where,
                           std::vector<std::string>& warnings) {
  const double width = static_cast<double>(camera.width), height = static_cast<double>(camera.height);
  const double fx = camera.intrinsics(0, 0), fy = camera.intrinsics(1, 1);
  const double cx = camera.intrinsics(0, 2), cy = camera.intrinsics(1, 2);
  if (fx < 0.1 * width || fx > 10 * width) {
    warnings.push_back(fmt::format("{}: the focal length is {:.3g} image widths", where, fx / width));
  }
  if (fx > 2 * fy || fy > 2 * fx) {
    warnings.push_back(
        fmt::format("{}: the pixels are far from square (fx = {:.4g}, fy = {:.4g})", where, fx, fy));
  }
  if (cx < 0 || cx > width || cy < 0 || cy > height) {
    warnings.push_back(
        fmt::format("{}: the principal point ({:.4g}, {:.4g}) is outside the image", where, cx, cy));
  }
}

}  // namespace

void check_camera(const Camera& camera, const std::string& where) {
  if (camera.width < 1 || camera.height < 1) {
    fail({where, "an image size of at least one pixel", fmt::format("{} x {}", camera.width, camera.height),
          "give the width and height in pixels"});
  }
  check_intrinsics(camera, where);
  check_pose(camera, where);
}

std::vector<std::string> check_cameras(const Views& views, const std::string& where) {
  if (views.num_sources < 1 || views.num_sources > views.size()) {
    fail({where, fmt::format("between 1 and {} source views", views.size()),
          std::to_string(views.num_sources), "name the source views"});
  }
  std::vector<std::string> warnings;
  for (int64_t i = 0; i < views.size(); ++i) {
    const Camera& camera = views.cameras[static_cast<size_t>(i)];
    const std::string place = fmt::format("{}, camera {}", where, i);
    check_camera(camera, place);
    warn_about_intrinsics(camera, place, warnings);
  }
  for (const std::string& warning : relative_cameras(views).warnings) {
    warnings.push_back(fmt::format("{}: {}", where, warning));
  }
  return warnings;
}

}  // namespace gld
