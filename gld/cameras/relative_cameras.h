#pragma once

#include "gld/cameras/camera.h"

#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace gld {

// What a translation of 1 is: the largest absolute component, as in the release, or the largest distance from the
// reference view, which does not change when the reference camera is turned (the paper: "the largest camera distance is
// 1").
enum class TranslationUnit { kLargestComponent, kLargestDistance };

// The cameras of one scene as the diffusion models see them (DESIGN.md section 4, "Cameras"): poses relative to
// one view, translations divided by (that unit + 1e-8). All in double, so that the distance of the scene from the
// world's origin does not matter.
struct RelativeCameras {
  // The pinhole cameras of the scene with world_from_camera replaced by reference_from_camera, its translation
  // multiplied by translation_scale. View order is kept.
  Views views;
  // The cameras in the world's own frame, translations multiplied by the same scale. They carry the distance of the
  // scene from the origin; only published models with special tokens need them (gld/camera_encoding/prope.h).
  Views world_views;
  // 1 / (the unit + 1e-8), in 1 / world units; 1 where there is no baseline.
  double translation_scale = 1;
  // Each is one sentence; the list is not empty where the camera centres coincide to the precision of the poses. Every
  // translation is then exactly zero.
  std::vector<std::string> warnings;
};

// reference_view counts from the end when negative: -1 is the last view, which the published models use.
// Throws Error when there is no such view. The cameras must have passed check_cameras (gld/cameras/camera_checks.h).
RelativeCameras relative_cameras(const Views& views, int64_t reference_view = -1,
                                 TranslationUnit unit = TranslationUnit::kLargestComponent);

// Returns K_norm of PRoPE's lifted projection P = K_norm [R | t] as a 4x4 matrix; it holds fx/W, fy/H, cx/W - 0.5,
// cy/H - 0.5 (DESIGN.md section 4, "PRoPE").
Eigen::Matrix4d lifted_intrinsics(const Eigen::Matrix3d& intrinsics, double width, double height);

// Returns the source whose camera stands nearest to that view's, of several the first. views has a source.
int64_t nearest_source(const Views& views, int64_t view);

}  // namespace gld
