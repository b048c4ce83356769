#include "train/objectives/geometry_loss.h"

#include "gld/cameras/angles.h"
#include "gld/cameras/nearest_rotation.h"

#include <cmath>
#include <limits>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace gld {
namespace {

constexpr double kExactOrigin = 0.02;    // of the baseline
constexpr double kLeastBaseline = 1e-4;  // in units of the scene's size; less is a camera that only turns

// Returns the mean distance of the later views' centres from the first view's, which is the origin.
double baseline_of(const torch::Tensor& true_rays) {
  const int64_t views = true_rays.size(0);
  if (views < 2) return 0;
  return true_rays.select(1, 0)
      .select(1, 0)
      .narrow(1, 3, 3)
      .narrow(0, 1, views - 1)
      .norm(2, 1)
      .mean()
      .item<double>();
}

torch::Tensor masked_mean(const torch::Tensor& values, const torch::Tensor& mask) {
  const auto weights = mask.to(values.dtype());
  return (values * weights).sum() / weights.sum().clamp_min(1.0);
}

torch::Tensor confident_mean(const torch::Tensor& error, const torch::Tensor& confidence,
                             const torch::Tensor& mask, double reward) {
  return masked_mean(confidence * error - reward * confidence.log(), mask);
}

// Returns differences between neighbours along dimension dim, where both are known.
torch::Tensor gradient_error(const torch::Tensor& error, const torch::Tensor& mask, int64_t dim) {
  const int64_t length = error.size(dim) - 1;
  const auto both = mask.narrow(dim, 0, length).logical_and(mask.narrow(dim, 1, length));
  return masked_mean(error.diff(1, dim).abs(), both);
}

torch::Tensor absolute_relative(const torch::Tensor& error, const torch::Tensor& depth,
                                const torch::Tensor& mask) {
  return masked_mean(error.abs() / depth.clamp_min(1e-6), mask);
}

torch::Tensor origin_error(const torch::Tensor& predicted_rays, const torch::Tensor& true_rays) {
  const double baseline = baseline_of(true_rays);
  if (baseline <= kLeastBaseline) return torch::zeros({}, predicted_rays.options());
  const auto off = (predicted_rays - true_rays).narrow(3, 3, 3) / baseline;
  return (off.square().sum(3) + kExactOrigin * kExactOrigin).sqrt().mean() - kExactOrigin;
}

}  // namespace

void GeometryLossOptions::visit(FieldVisitor& visitor) {
  visitor.real({"depth_weight", "weight of the depth error"}, depth_weight, {0.0, 1e6});
  visitor.real({"relative_weight", "weight of the relative depth error"}, relative_weight, {0.0, 1e6});
  visitor.real({"gradient_weight", "weight of the error of depth differences between neighbours"},
               gradient_weight, {0.0, 1e6});
  visitor.real({"ray_weight", "weight of the ray error"}, ray_weight, {0.0, 1e6});
  visitor.real(
      {"origin_weight", "weight of the distance of ray origins from the camera's centre, over the baseline"},
      origin_weight, {0.0, 1e6});
  visitor.real(
      {"point_weight", "weight of the error of points: of depth * direction + centre, and of predicted ones"},
      point_weight, {0.0, 1e6});
  visitor.real({"camera_weight",
                "weight of the error of cameras that the head decodes beside its rays; 0: not trained"},
               camera_weight, {0.0, 1e6});
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
  losses.origin = origin_error(predicted.rays, targets.rays);
  const std::vector<int64_t> grid = {targets.rays.size(1), targets.rays.size(2)};
  const auto cell_depth =
      torch::upsample_bilinear2d(predicted.depth.unsqueeze(1), grid, /*align_corners=*/false)
          .permute({0, 2, 3, 1});
  const auto point = predicted.rays.narrow(3, 0, 3) * cell_depth + predicted.rays.narrow(3, 3, 3);
  const auto true_point =
      targets.rays.narrow(3, 0, 3) * targets.ray_depth.unsqueeze(3) + targets.rays.narrow(3, 3, 3);
  losses.point = masked_mean((point - true_point).abs().mean(3), targets.ray_valid);
  if (predicted.points.defined()) {
    const auto on_grid = [&](const torch::Tensor& channels_first) {
      return torch::upsample_bilinear2d(channels_first, grid, /*align_corners=*/false).permute({0, 2, 3, 1});
    };
    const auto error = (on_grid(predicted.points.permute({0, 3, 1, 2})) - true_point).abs().mean(3);
    losses.point_map = confident_mean(error, on_grid(predicted.point_confidence.unsqueeze(1)).squeeze(3),
                                      targets.ray_valid, options.confidence_reward);
  }
  losses.absolute_relative = absolute_relative(depth_error, targets.depth, targets.valid);
  losses.total = options.depth_weight * losses.depth + options.gradient_weight * losses.gradient +
                 options.ray_weight * losses.ray + options.origin_weight * losses.origin +
                 options.point_weight * losses.point;
  if (losses.point_map.defined()) losses.total = losses.total + options.point_weight * losses.point_map;
  if (predicted.camera_encodings.defined()) {
    losses.camera = (predicted.camera_encodings - targets.cameras).abs().mean();
    losses.total = losses.total + options.camera_weight * losses.camera;
  }
  if (options.relative_weight > 0) {
    losses.total = losses.total + options.relative_weight * losses.absolute_relative;
  }
  losses.absolute_relative = losses.absolute_relative.detach();
  return losses;
}

RayErrors& RayErrors::operator+=(const RayErrors& other) {
  direction_degrees += other.direction_degrees;
  rotation_degrees += other.rotation_degrees;
  translation_degrees += other.translation_degrees;
  origin += other.origin;
  return *this;
}

RayErrors ray_errors(const torch::Tensor& predicted_rays, const GeometryTargets& targets) {
  const auto predicted = predicted_rays.detach().to(torch::kCPU).to(torch::kFloat64);
  const auto truth = targets.rays.to(torch::kCPU).to(torch::kFloat64);
  const int64_t views = truth.size(0);
  const auto unit = [](const torch::Tensor& rays) {
    const auto directions = rays.narrow(3, 0, 3);
    return directions / directions.norm(2, {3}, /*keepdim=*/true).clamp_min(1e-12);
  };
  const auto from = unit(truth), to = unit(predicted);
  RayErrors errors;
  // The angle is found by the chord: the arc cosine has no digits left at small angles.
  errors.direction_degrees =
      kDegreesPerRadian * (2 * ((from - to).norm(2, 3) / 2).clamp_max(1.0).asin()).mean().item<double>();
  errors.rotation_degrees = errors.translation_degrees = errors.origin =
      std::numeric_limits<double>::quiet_NaN();
  if (views < 2) return errors;

  // The turn that takes a view's true directions to the predicted ones (orthogonal Procrustes); relative to the first
  // view's, it is the error of the relative rotation.
  const auto turn_of = [&](int64_t view) {
    const auto products =
        torch::matmul(to[view].reshape({-1, 3}).t(), from[view].reshape({-1, 3})).contiguous();
    const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> sum(products.data_ptr<double>());
    return nearest_rotation(sum);
  };
  const auto centre_of = [](const torch::Tensor& rays, int64_t view) {
    const auto centre = rays[view].reshape({-1, 6}).narrow(1, 3, 3).mean(0);
    return Eigen::Vector3d(centre[0].item<double>(), centre[1].item<double>(), centre[2].item<double>());
  };
  const double baseline = baseline_of(truth);
  const Eigen::Matrix3d first_turn = turn_of(0);
  const Eigen::Vector3d first_centre = centre_of(predicted, 0);
  double rotation = 0, translation = 0, origin = 0;
  for (int64_t view = 1; view < views; ++view) {
    rotation += Eigen::AngleAxisd(turn_of(view).transpose() * first_turn).angle();
    const Eigen::Vector3d centre = centre_of(predicted, view), true_centre = centre_of(truth, view);
    const Eigen::Vector3d step = centre - first_centre;
    translation += std::atan2(step.cross(true_centre).norm(), step.dot(true_centre));
    origin += (centre - true_centre).norm();
  }
  const auto others = static_cast<double>(views - 1);
  errors.rotation_degrees = kDegreesPerRadian * rotation / others;
  if (baseline > kLeastBaseline) {
    errors.translation_degrees = kDegreesPerRadian * translation / others;
    errors.origin = origin / others / baseline;
  }
  return errors;
}

TokenGeometryLosses token_geometry_losses(const torch::Tensor& read, const GeometryTargets& targets,
                                          const RayGrid& tokens, const GeometryLossOptions& options) {
  const int64_t views = read.size(0), side = kTokenDepthsASide;
  const auto by_token = [&](const torch::Tensor& map) {  // (views, 4 rows, 4 columns) -> (views, tokens, 16)
    return map.view({views, tokens.rows, side, tokens.columns, side})
        .permute({0, 1, 3, 2, 4})
        .reshape({views, tokens.rows * tokens.columns, kTokenDepths});
  };
  const auto depth = by_token(targets.ray_depth), valid = by_token(targets.ray_valid);
  // Directions are linear in the pixel, so the mean of a patch's rays is the one through its middle.
  const auto middle =
      targets.rays.view({views, tokens.rows, side, tokens.columns, side, 6}).mean(std::vector<int64_t>{2, 4});
  const auto log_depth = read.narrow(2, 0, kTokenDepths);
  const auto rays = read.narrow(2, kTokenDepths, 6).view(middle.sizes());
  TokenGeometryLosses losses;
  losses.total = masked_mean((log_depth - depth.clamp_min(1e-6).log()).abs(), valid) +
                 (rays - middle).narrow(3, 0, 3).abs().mean() +
                 options.origin_weight * origin_error(rays, middle);
  if (!torch::GradMode::is_enabled()) {
    GeometryTargets of_tokens;
    of_tokens.rays = middle;
    losses.rays = ray_errors(rays, of_tokens);
    losses.depth_abs_rel = absolute_relative(log_depth.exp() - depth, depth, valid).item<double>();
  }
  return losses;
}

}  // namespace gld
