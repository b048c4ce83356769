#include "train/objectives/geometry_loss.h"

namespace gld {
namespace {

torch::Tensor masked_mean(const torch::Tensor& values, const torch::Tensor& mask) {
  const auto weights = mask.to(values.dtype());
  return (values * weights).sum() / weights.sum().clamp_min(1.0);
}

torch::Tensor confident_mean(const torch::Tensor& error, const torch::Tensor& confidence,
                             const torch::Tensor& mask, double reward) {
  return masked_mean(confidence * error - reward * confidence.log(), mask);
}

// Differences between neighbours along dimension dim, where both are known.
torch::Tensor gradient_error(const torch::Tensor& error, const torch::Tensor& mask, int64_t dim) {
  const int64_t length = error.size(dim) - 1;
  const auto both = mask.narrow(dim, 0, length).logical_and(mask.narrow(dim, 1, length));
  return masked_mean(error.diff(1, dim).abs(), both);
}

}  // namespace

void GeometryLossOptions::visit(FieldVisitor& visitor) {
  visitor.real({"depth_weight", "weight of the depth error"}, depth_weight, {0.0, 1e6});
  visitor.real({"relative_weight", "weight of the relative depth error"}, relative_weight, {0.0, 1e6});
  visitor.real({"gradient_weight", "weight of the error of depth differences between neighbours"},
               gradient_weight, {0.0, 1e6});
  visitor.real({"ray_weight", "weight of the ray error"}, ray_weight, {0.0, 1e6});
  visitor.real({"point_weight", "weight of the error of depth * direction + centre"}, point_weight,
               {0.0, 1e6});
  visitor.real({"confidence_reward", "lambda of the reward for confidence"}, confidence_reward, {1e-6, 1e6});
}

GeometryLosses geometry_losses(const GeometryOutput& predicted, const GeometryTargets& targets,
                               const GeometryLossOptions& options) {
  GeometryLosses losses;
  const auto depth_error = predicted.depth - targets.depth;
  losses.depth =
      confident_mean(depth_error.abs(), predicted.depth_confidence, targets.valid, options.confidence_reward);
  losses.gradient =
      gradient_error(depth_error, targets.valid, 1) + gradient_error(depth_error, targets.valid, 2);
  // Rays exist for every cell, also where depth is unknown.
  const auto ray_error = (predicted.rays - targets.rays).abs().mean(3);
  losses.ray = confident_mean(ray_error, predicted.ray_confidence, torch::ones_like(targets.ray_valid),
                              options.confidence_reward);
  const std::vector<int64_t> grid = {targets.rays.size(1), targets.rays.size(2)};
  const auto cell_depth =
      torch::upsample_bilinear2d(predicted.depth.unsqueeze(1), grid, /*align_corners=*/false)
          .permute({0, 2, 3, 1});
  const auto point = predicted.rays.narrow(3, 0, 3) * cell_depth + predicted.rays.narrow(3, 3, 3);
  const auto true_point =
      targets.rays.narrow(3, 0, 3) * targets.ray_depth.unsqueeze(3) + targets.rays.narrow(3, 3, 3);
  losses.point = masked_mean((point - true_point).abs().mean(3), targets.ray_valid);
  losses.absolute_relative = masked_mean(depth_error.abs() / targets.depth.clamp_min(1e-6), targets.valid);
  losses.total = options.depth_weight * losses.depth + options.gradient_weight * losses.gradient +
                 options.ray_weight * losses.ray + options.point_weight * losses.point;
  if (options.relative_weight > 0) {
    losses.total = losses.total + options.relative_weight * losses.absolute_relative;
  }
  losses.absolute_relative = losses.absolute_relative.detach();
  return losses;
}

}  // namespace gld
