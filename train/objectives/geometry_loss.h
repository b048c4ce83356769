#pragma once

#include "gld/base/options.h"
#include "models/decoders/dpt_head.h"
#include "train/objectives/geometry_targets.h"

#include <torch/types.h>

namespace gld {

struct GeometryLossOptions : OptionsGroup {
  double depth_weight = 1.0;
  double relative_weight = 0.0;
  double gradient_weight = 1.0;
  double ray_weight = 1.0;
  double point_weight = 1.0;
  double confidence_reward = 0.2;

  void visit(FieldVisitor& visitor) override;
};

// Depth Anything 3, section 3.3: absolute errors of depth and rays, weighted by the predicted confidence c with
// the reward -lambda log c; absolute errors of depth differences between neighbouring pixels, and of the points
// depth * direction + centre. Means over known pixels, all scalars. Not in the paper: with relative_weight the
// absolute relative error of depth is added, in which near surfaces weigh more than far ones.
struct GeometryLosses {
  torch::Tensor depth, gradient, ray, point;
  torch::Tensor total;
  torch::Tensor absolute_relative;  // mean |predicted - true| / true
};

GeometryLosses geometry_losses(const GeometryOutput& predicted, const GeometryTargets& targets,
                               const GeometryLossOptions& options);

}  // namespace gld
