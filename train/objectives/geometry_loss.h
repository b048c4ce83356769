#pragma once

#include "gld/base/options.h"
#include "models/decoders/geometry_head.h"
#include "train/objectives/geometry_targets.h"

#include <torch/types.h>

namespace gld {

struct GeometryLossOptions : OptionsGroup {
  double depth_weight = 1.0;
  double relative_weight = 0.0;
  double gradient_weight = 1.0;
  double ray_weight = 1.0;
  double origin_weight = 1.0;
  double point_weight = 1.0;
  double camera_weight = 0.0;
  double confidence_reward = 0.2;

  void visit(FieldVisitor& visitor) override;
};

// Depth Anything 3, section 3.3: absolute errors of depth and rays, weighted by the predicted confidence c with
// the reward -lambda log c; absolute errors of depth differences between neighbouring pixels, and of the points
// depth * direction + centre. Means over known pixels, all scalars. Not in the paper: with relative_weight the
// absolute relative error of depth is added, in which near surfaces weigh more than far ones.
//
// Origins have a loss of their own: beside directions of length one they are small numbers, an absolute error of both
// leaves them at the median of what is not known, which is 0, and the scale of the scene is then lost. Theirs is the
// distance from the true centre over the scene's baseline (mean distance of the other centres from the first), which
// grows like a square below kExactOrigin and like the distance above. A scene without a baseline has none.
//
// Cameras that a head decodes beside its rays (DA3's) have the mean absolute error of their nine numbers.
//
// Points that a head predicts apart from depth (VGGT's) have the error of depth's points with their own confidence.
struct GeometryLosses {
  torch::Tensor depth, gradient, ray, origin, point;
  torch::Tensor point_map;  // undefined of heads without
  torch::Tensor camera;     // the same
  torch::Tensor total;
  torch::Tensor absolute_relative;  // mean |predicted - true| / true
};

// What the rays are worth as cameras, over all views of a scene; what needs a second view is NaN without one.
struct RayErrors {
  double direction_degrees = 0;    // mean angle of the directions
  double rotation_degrees = 0;     // mean over the later views: of the rotation relative to the first view
  double translation_degrees = 0;  // the same: angle of the centre's direction from the first view's
  double origin = 0;  // the same: distance of the centre from the true one, over the scene's baseline

  RayErrors& operator+=(const RayErrors& other);
};

RayErrors ray_errors(const torch::Tensor& predicted_rays, const GeometryTargets& targets);

// A linear layer reads this off a level for each patch token: kTokenDepths log depths on a 4x4 grid of the patch, then
// the ray through its middle (direction and origin).
constexpr int64_t kTokenDepthsASide = 4;
constexpr int64_t kTokenDepths = kTokenDepthsASide * kTokenDepthsASide;
constexpr int64_t kTokenGeometry = kTokenDepths + 6;

struct TokenGeometryLosses {
  torch::Tensor
      total;  // mean absolute errors of log depth and of the direction, and the weighted origin's as above; scalar
  RayErrors rays;            // without gradients only
  double depth_abs_rel = 0;  // the same
};

// Of options the origin's weight counts. read is (views, rows * columns, kTokenGeometry); targets are on a ray grid of
// 4 rows x 4 columns a token.
TokenGeometryLosses token_geometry_losses(const torch::Tensor& read, const GeometryTargets& targets,
                                          const RayGrid& tokens, const GeometryLossOptions& options);

GeometryLosses geometry_losses(const GeometryOutput& predicted, const GeometryTargets& targets,
                               const GeometryLossOptions& options);

}  // namespace gld
