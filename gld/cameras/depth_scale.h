#pragma once

#include "gld/cameras/pose_alignment.h"

#include <optional>
#include <string>
#include <vector>

namespace gld {

// The length in the world of one unit of the geometry model's depth, and how far to believe it. Every way of finding it
// gives one of these, so that they can be compared.
struct DepthScale {
  std::string estimator;  // "camera_poses"
  double scale = 1;       // > 0
  double low = 1;         // two standard errors to both sides; 0 <= low <= scale <= high
  double high = 1;
  double residual = 0;  // what the estimator's fit leaves, relative to what it fits; 0 is perfect
};

// From the distances between the predicted cameras and those between the given ones: the residual is that of the centres
// relative to their spread. Nothing where the alignment does not know the scale.
std::optional<DepthScale> depth_scale_from_poses(const PoseAlignment& world_from_model);

// The estimate with the narrowest interval relative to its scale, the first of equals; nothing of none.
std::optional<DepthScale> surest_depth_scale(const std::vector<DepthScale>& estimates);

}  // namespace gld
