#pragma once

#include "gld/cameras/camera.h"

#include <cstdint>
#include <vector>

#include <torch/types.h>

namespace gld {

// A view whose features are matched with another's.
struct CorrespondenceView {
  torch::Tensor features;  // (channels, rows, columns), covering the picture evenly
  torch::Tensor depth;     // (height, width), planar and exact, of the camera's size; 0 where unknown
  Camera camera;
};

// Returns how far matched features are from true correspondence, as Probe3D measures it (El Banani et al. 2024): every
// fourth pixel of both views with known depth is a point, seen at the middle of its cell of the grid of a quarter the
// size, where features are read off bilinearly. Each point of `from` has its nearest neighbour in `to` by cosine; the
// surest by the ratio test (1 - d1 / d2 of the distances to the two nearest) are kept: 1000 at most, as published, and
// no more than a quarter of the points, so that the test still chooses in small pictures. The error is the distance in
// `to` between where the point of `from` truly falls and its neighbour, in units of 1/160 of the picture's longer side,
// which are pixels of Probe3D's grid, where pictures have 640 x 480 pixels. A point behind `to` has an infinite error.
// Nothing is left out because it is hidden or falls outside `to`, as published. The list is empty without 2 points in
// each view.
std::vector<double> correspondence_errors(const CorrespondenceView& from, const CorrespondenceView& to);

constexpr double kPckThreshold = 10;  // the headline, in those units

// Returns the share of errors below a threshold, in percent; it is NaN of none.
double correct_keypoints(const std::vector<double>& errors, double threshold = kPckThreshold);

}  // namespace gld
