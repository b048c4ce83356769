#pragma once

#include <torch/types.h>

namespace gld {

// Returns the median distance of the points from the nearest point of a surface, (points, 3) and (surface points, 3) in
// one unit. Of more than 4000 points or 200 000 surface points every n-th is taken. It is NaN of no points or no
// surface.
double median_cloud_distance(const torch::Tensor& points, const torch::Tensor& surface);

// Returns the largest side of the box around the points, (points, 3).
double largest_side(const torch::Tensor& points);

}  // namespace gld
