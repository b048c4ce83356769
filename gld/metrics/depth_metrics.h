#pragma once

#include <torch/types.h>

namespace gld {

// Errors of predicted depth maps (views, height, width), in the unit of the true ones, over the pixels where the true
// depth is finite and positive. Each is (views), float64; a view without such a pixel has NaN.
struct DepthErrors {
  torch::Tensor abs_rel;       // mean |prediction - truth| / truth
  torch::Tensor sq_rel;        // mean (prediction - truth)^2 / truth, in that unit
  torch::Tensor rmse;          // root mean squared difference, in that unit
  torch::Tensor delta1;        // share of pixels with max(prediction / truth, truth / prediction) < 1.25
  torch::Tensor delta2;        // < 1.25^2
  torch::Tensor delta3;        // < 1.25^3
  torch::Tensor valid_pixels;  // how many were compared, int64
};

// For the deltas predictions are clamped to at least 0.001, so that a zero counts as wrong and divides nothing.
DepthErrors depth_errors(const torch::Tensor& truth, const torch::Tensor& prediction);

// These return one factor for all views of a scene that brings predictions to the truth's unit; predictions are known
// only up to scale. Multiply the predictions with it before depth_errors. Both throw Error when no pixel has a valid
// truth and a positive finite prediction. This is the median of truth / prediction, which is robust against outliers.
double median_depth_scale(const torch::Tensor& truth, const torch::Tensor& prediction);
// argmin over s of sum (s prediction - truth)^2.
double least_squares_depth_scale(const torch::Tensor& truth, const torch::Tensor& prediction);

}  // namespace gld
