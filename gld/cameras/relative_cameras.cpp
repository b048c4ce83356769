#include "gld/cameras/relative_cameras.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cfloat>
#include <cmath>

namespace gld {
namespace {

bool is_single_precision(double value) { return static_cast<double>(static_cast<float>(value)) == value; }

// Differences of camera centres at or below this are rounding. It is of single precision where every coordinate is a
// single-precision number (poses from float32 files), of double precision with room for a matrix inverse otherwise.
double centre_resolution(const Views& views) {
  double largest = 0;
  bool single_precision = true;
  for (const Camera& camera : views.cameras) {
    const Eigen::Vector3d centre = camera.world_from_camera.translation();
    largest = std::max(largest, centre.cwiseAbs().maxCoeff());
    for (int axis = 0; axis < 3; ++axis)
      single_precision = single_precision && is_single_precision(centre[axis]);
  }
  constexpr double kSmallestCentre = 1e-12;  // zeros that went through a matrix inverse
  return std::max(kSmallestCentre, largest * (single_precision ? 2.0 * FLT_EPSILON : 1e-12));
}

}  // namespace

RelativeCameras relative_cameras(const Views& views, int64_t reference_view, TranslationUnit unit) {
  const int64_t index = reference_view < 0 ? views.size() + reference_view : reference_view;
  if (index < 0 || index >= views.size()) {
    fail({"reference_view", "one of " + std::to_string(views.size()) + " views",
          std::to_string(reference_view), "use -1 for the last view"});
  }
  RelativeCameras relative;
  relative.views = views;
  relative.world_views = views;
  const Eigen::Isometry3d world_from_reference = views.cameras[static_cast<size_t>(index)].world_from_camera;
  const Eigen::Matrix3d reference_from_world = world_from_reference.linear().transpose();
  double world_baseline = 0;
  double largest = 0;
  for (Camera& camera : relative.views.cameras) {
    // Centres are subtracted before they are rotated: composing 4x4 matrices would rotate two large offsets and
    // subtract their rounding errors.
    const Eigen::Vector3d offset =
        camera.world_from_camera.translation() - world_from_reference.translation();
    world_baseline = std::max(world_baseline, offset.cwiseAbs().maxCoeff());
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.linear() = reference_from_world * camera.world_from_camera.linear();
    pose.translation() = reference_from_world * offset;
    camera.world_from_camera = pose;
    largest = std::max(largest, unit == TranslationUnit::kLargestDistance
                                    ? pose.translation().norm()
                                    : pose.translation().cwiseAbs().maxCoeff());
  }
  if (world_baseline <= centre_resolution(views)) {
    for (Views* frame : {&relative.views, &relative.world_views}) {
      for (Camera& camera : frame->cameras) camera.world_from_camera.translation().setZero();
    }
    if (views.size() > 1) {
      relative.warnings.push_back(
          "the camera centres coincide, so there is no baseline: translations are taken as exactly zero");
    }
    return relative;
  }
  constexpr double kScaleOffset = 1e-8;
  relative.translation_scale = 1.0 / (largest + kScaleOffset);
  for (Views* frame : {&relative.views, &relative.world_views}) {
    for (Camera& camera : frame->cameras)
      camera.world_from_camera.translation() *= relative.translation_scale;
  }
  return relative;
}

Eigen::Matrix4d lifted_intrinsics(const Eigen::Matrix3d& intrinsics, double width, double height) {
  Eigen::Matrix4d lifted = Eigen::Matrix4d::Identity();
  lifted(0, 0) = intrinsics(0, 0) / width;
  lifted(1, 1) = intrinsics(1, 1) / height;
  lifted(0, 2) = intrinsics(0, 2) / width - 0.5;
  lifted(1, 2) = intrinsics(1, 2) / height - 0.5;
  return lifted;
}

int64_t nearest_source(const Views& views, int64_t view) {
  const auto centre = [&](int64_t of) {
    return views.cameras[static_cast<size_t>(of)].world_from_camera.translation();
  };
  int64_t nearest = 0;
  for (int64_t source = 1; source < views.num_sources; ++source) {
    if ((centre(source) - centre(view)).norm() < (centre(nearest) - centre(view)).norm()) nearest = source;
  }
  return nearest;
}

}  // namespace gld
