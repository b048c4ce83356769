#pragma once

#include "gld/cameras/camera.h"
#include "gld/cameras/image_size.h"
#include "gld/photogrammetry/view_maps.h"

#include <cstdint>
#include <vector>

#include <Eigen/Core>

namespace gld {

// A view's ray map in double: cells row by row. confidence: one a cell.
struct RayGrid {
  int64_t width = 0;
  int64_t height = 0;
  std::vector<Eigen::Vector3d> directions;
  std::vector<Eigen::Vector3d> origins;
  std::vector<double> confidence;
};

// An empty confidence weighs all alike. Rays that are not finite, or whose confidence is not, have confidence 0.
RayGrid ray_grid(const RayMap& rays, const ConfidenceMap& confidence);

// The ways in which published code turns rays into cameras, faults included, for figures that are compared with
// published ones; gld/photogrammetry/pose_from_rays.h is ours. size: of the pictures that the maps cover. Both return
// one camera a view, in the frame of the rays, and throw Error for a view whose rays no camera fits.

// Depth Anything 3: a homography from the plane of a camera of focal length 1 to the directions' plane, by RANSAC (100
// draws of 8 among the surest 30 %, the same places for all views, inliers within 0.2) and a weighted direct linear
// transform over the inliers (of at most 8000 among the surest 95 %); H = R L with L lower triangular gives the
// rotation and the intrinsics, which is right only where the principal point is the picture's middle. Directions that
// look sideways or back from the world's z axis lie outside that plane. The centre is the mean of the origins by
// confidence.
std::vector<Camera> cameras_from_rays_da3(const std::vector<RayGrid>& views, const ImageSize& size);

// GLD's release: for every fourth cell a linear least squares fit d = H (u, v, 1) of whole cells (u, v), both sides
// times the confidence; one K = H_0^-1 for all views and R_v the rotation nearest to H_v H_0^-1, so that rotations are
// relative to the first view while centres, means of the origins by confidence, are not; directions must have one
// length in all views. No outlier is left out, and K is half a cell off.
std::vector<Camera> cameras_from_rays_gld(const std::vector<RayGrid>& views, const ImageSize& size);

}  // namespace gld
