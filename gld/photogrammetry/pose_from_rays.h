#pragma once

#include "gld/cameras/camera.h"
#include "gld/cameras/image_size.h"
#include "gld/photogrammetry/view_maps.h"

#include <cstdint>
#include <optional>

#include <Eigen/Core>

namespace gld {

struct RecoveredCamera {
  Camera camera;               // in the frame of the rays, intrinsics in pixels of the picture
  double direction_error = 0;  // median angle between the map's directions and the camera's, degrees
  double origin_error = 0;     // median distance of the map's origins from the centre
  double inliers = 0;          // fraction of the used rays that the robust fit believes
};

// What is known of a camera before its rays are looked at, in pixels of the picture.
struct KnownIntrinsics {
  Eigen::Vector2d principal_point = Eigen::Vector2d::Zero();
  std::optional<Eigen::Vector2d> focal_lengths;
};

// Returns the pinhole camera whose rays fit the map best; size is that of the picture that the map covers. The
// directions' lengths do not matter. First comes a linear fit of direction ~ M (u, v, 1), M = rotation * intrinsics^-1
// up to scale, by the smallest eigenvector of the normal equations of direction x M (u, v, 1) = 0, reweighted with
// Cauchy weights against outliers; a QR decomposition parts M. Then comes Gauss-Newton on the angles with zero skew.
// The principal point is recovered too, which trades off against a turn of the camera and so needs good rays; what is
// known is kept. The centre is a robust mean of the origins. Rays that are not finite, or whose confidence is not
// positive and finite, are left out; an empty confidence weighs all alike. Throws Error for fewer than 16 usable rays,
// for rays that do not spread, and for mirrored ones.
RecoveredCamera camera_from_rays(const RayMap& rays, const ConfidenceMap& confidence, const ImageSize& size,
                                 const std::optional<KnownIntrinsics>& known = std::nullopt);

// Returns the rays of a camera on a map of that size: directions rotation * intrinsics^-1 * (u, v, 1) at the cells'
// centres, and the camera's centre as origin.
RayMap rays_of_camera(const Camera& camera, int64_t map_width, int64_t map_height);

}  // namespace gld
