#pragma once

#include "gld/cameras/pose_alignment.h"

#include <optional>
#include <string>
#include <vector>

namespace gld {

// The length in the world of one unit of the geometry model's depth, and how far to believe it. Every way of finding it
// gives one of these, so that they can be compared.
struct DepthScale {
  std::string estimator;  // "camera_poses", "photographs", ...; several joined by " + "
  double scale = 1;       // > 0
  double low = 1;         // two standard errors to both sides; 0 <= low <= scale <= high
  double high = 1;
  double residual = 0;  // what the estimator's fit leaves, relative to what it fits; 0 is perfect
};

// The scale is from the distances between the predicted cameras and those between the given ones: the residual is what
// is left between the centres, relative to their spread, and between the orientations, in radians; the interval is as
// wide as that says at least, because errors of predicted centres are not independent. Returns nothing where the
// cameras stand at one place.
std::optional<DepthScale> depth_scale_from_poses(const PoseAlignment& world_from_model);

// Returns the same estimate, where the logarithm of what it was compared with is off by an independent error of that
// standard deviation.
DepthScale with_log_deviation(DepthScale estimate, double log_deviation);

// Returns why an estimate does not tell the scale, as a phrase: its fit leaves more than 0.4 of what it is fitted to,
// or its interval is wider than a factor of 4. The phrase is empty where it tells it.
std::string doubt_about(const DepthScale& estimate);

// Returns what the estimates without doubt say together: the one with the narrowest interval, and with it all whose
// intervals overlap with its own, their logarithms weighted by their precision. Returns nothing where all are in doubt.
std::optional<DepthScale> combined_depth_scale(const std::vector<DepthScale>& estimates);

}  // namespace gld
