#include "gld/cameras/depth_scale.h"

#include <algorithm>

namespace gld {

std::optional<DepthScale> depth_scale_from_poses(const PoseAlignment& world_from_model) {
  if (!world_from_model.scale_known) return std::nullopt;
  DepthScale estimate;
  estimate.estimator = "camera_poses";
  estimate.scale = world_from_model.b_from_a.scale;
  estimate.low = std::max(0.0, estimate.scale - 2 * world_from_model.scale_deviation);
  estimate.high = estimate.scale + 2 * world_from_model.scale_deviation;
  estimate.residual = world_from_model.centre_error / world_from_model.spread;
  return estimate;
}

std::optional<DepthScale> surest_depth_scale(const std::vector<DepthScale>& estimates) {
  const auto doubt = [](const DepthScale& estimate) {
    return (estimate.high - estimate.low) / estimate.scale;
  };
  const auto surest =
      std::min_element(estimates.begin(), estimates.end(),
                       [&](const DepthScale& a, const DepthScale& b) { return doubt(a) < doubt(b); });
  if (surest == estimates.end()) return std::nullopt;
  return *surest;
}

}  // namespace gld
