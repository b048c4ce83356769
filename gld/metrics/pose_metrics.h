#pragma once

#include "gld/cameras/camera.h"

#include <vector>

#include <torch/types.h>

namespace gld {

// How far predicted rays, and the cameras that fit them, are from the scene's cameras. Each is (targets), float64. Both
// sides are seen from their own first view (the first source), so that the frame and unit in which a model predicts do
// not count; what the first view's camera is wrong by goes into every target.
struct PoseErrors {
  torch::Tensor rotation;  // angle between the cameras' orientations, degrees
  // Angle between the directions from the first view's centre to the target's, degrees; NaN where either stands at one
  // place with the first view.
  torch::Tensor translation_direction;
  torch::Tensor ray_angle;  // mean angle between predicted and true ray directions, degrees
  // Mean distance between predicted and true ray origins over the baseline, the largest distance between two of the
  // scene's cameras, after one scale a scene that fits the predicted centres to the true ones best (least squares,
  // never negative): 0 is right, about 1 is as if all cameras stood at one place. NaN without a baseline.
  torch::Tensor ray_origin;
};

// predicted has one camera a view. rays is (views, rows, columns, 6), direction and origin in the frame of `predicted`;
// rays that are not finite are left out of the means. Throws Error unless there is one of each a view, and a target
// view.
PoseErrors pose_errors(const Views& views, const std::vector<Camera>& predicted, const torch::Tensor& rays);

// How far cameras that were estimated without being given any are from the true ones. Each is (views - 1), float64, one
// for every view behind the first, from which both sides are seen.
struct EstimatedCameraErrors {
  torch::Tensor rotation;               // degrees
  torch::Tensor translation_direction;  // degrees, as in PoseErrors
  // Distance between the centres over the baseline, after the best scale, as PoseErrors::ray_origin.
  torch::Tensor centre;
};
// One estimated camera a view; Error otherwise.
EstimatedCameraErrors estimated_camera_errors(const std::vector<Camera>& truth,
                                              const std::vector<Camera>& estimated);

}  // namespace gld
