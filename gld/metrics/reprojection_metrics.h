#pragma once

#include "gld/cameras/camera.h"

#include <array>
#include <cstdint>
#include <vector>

#include <torch/types.h>

#include <Eigen/Core>

namespace gld {

struct ColouredPoint {
  Eigen::Vector3d x_in_world;
  std::array<uint8_t, 3> rgb;
};

// Returns every pixel of every view whose depth is finite and positive, with the picture's colour in 8 bits. images is
// (views, 3, height, width) in [0, 1], clamped; depth is (views, height, width), planar, in the unit of the cameras,
// which have that size. Throws Error otherwise.
std::vector<ColouredPoint> coloured_points(const torch::Tensor& images, const torch::Tensor& depth,
                                           const std::vector<Camera>& cameras);

// Returns the cloud drawn into a camera, (3, height, width) in [0, 1], by the painter's rule: points in front of the
// camera fill the pixel that they fall into, from far to near, of two at one distance the later one on top, over black.
torch::Tensor painted_cloud(const std::vector<ColouredPoint>& points, const Camera& camera);

// How well depth and cameras of a scene agree, without any picture: the middle of a pixel of view i is lifted by its
// depth, seen in view j, lifted there by the depth of j (linear in its inverse between pixels, exact on planes) and
// seen again in view i. Over all ordered pairs of views.
struct RoundTrip {
  // Mean distance from where it started, pixels, over those that come back; NaN where none does. Pixels whose depth
  // differs by more than 5 % from that of the other view count as occluded and are left out: `agreement` says how many
  // were not.
  double pixels = 0;
  double agreement =
      0;  // of the pixels that fall into another view onto known depth, how many agree to 5 %; NaN where none
};
RoundTrip depth_round_trip(const torch::Tensor& depth, const std::vector<Camera>& cameras);

// Returns how far apart predicted cameras stand for the depth that goes with them, over how far apart the true ones do
// for theirs: the root mean square distance of the centres from their mean over the median known depth, of both. 1 is
// right; near 0 all predicted cameras stand at one place, where every reprojection looks good. It is NaN without two
// centres apart in the truth or without known depth.
double baseline_ratio(const std::vector<Camera>& cameras, const torch::Tensor& depth,
                      const std::vector<Camera>& true_cameras, const torch::Tensor& true_depth);

}  // namespace gld
