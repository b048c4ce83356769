#include "gld/metrics/cloud_metrics.h"

#include "gld/metrics/depth_metrics.h"
#include "gld/metrics/metric.h"

#include <algorithm>
#include <limits>
#include <string>
#include <vector>

namespace gld {
namespace {

torch::Tensor thinned(const torch::Tensor& points, int64_t most) {
  const int64_t step = (points.size(0) + most - 1) / most;
  return points.slice(0, 0, points.size(0), std::max<int64_t>(1, step)).to(torch::kFloat32).contiguous();
}

MetricValue one_value(double value) { return {torch::full({1}, value, torch::kFloat64), ""}; }

}  // namespace

double largest_side(const torch::Tensor& points) {
  return (points.amax(0) - points.amin(0)).max().item<double>();
}

double median_cloud_distance(const torch::Tensor& points, const torch::Tensor& surface) {
  if (points.size(0) == 0 || surface.size(0) == 0) return std::numeric_limits<double>::quiet_NaN();
  // Coordinates are around the surface's middle, so that a far origin costs no digits.
  const auto middle = surface.to(torch::kFloat64).mean(0, /*keepdim=*/true);
  const auto from = thinned(points.to(torch::kFloat64) - middle, 4000);
  const auto to = thinned(surface.to(torch::kFloat64) - middle, 200000);
  std::vector<torch::Tensor> nearest;
  constexpr int64_t kPointsAtOnce = 100;
  for (int64_t first = 0; first < from.size(0); first += kPointsAtOnce) {
    const int64_t count = std::min(kPointsAtOnce, from.size(0) - first);
    nearest.push_back(torch::cdist(from.narrow(0, first, count), to).amin(1));
  }
  return torch::cat(nearest).median().item<double>();
}

namespace {

Metric depth_scale_ratio_metric() {
  return {"depth_scale_ratio",
          "",
          Better::kNearOne,
          {MetricNeed::kTrueDepth, MetricNeed::kDepth, MetricNeed::kDepthScale},
          [](const MetricInputs& inputs) {
            if (!inputs.depth_scale_is_told)
              return absent_metric("the scale of the model's depth is not known");
            const auto truth = inputs.true_depth.to(torch::kCPU);
            const auto depth = inputs.depth.to(torch::kCPU, torch::kFloat64);
            if (!(truth.gt(0) & depth.isfinite() & depth.gt(0)).any().item<bool>()) {
              return absent_metric("no predicted depth is positive where the true one is known");
            }
            return one_value(*inputs.depth_scale / median_depth_scale(truth, depth));
          }};
}

Metric cloud_distance_metric() {
  return {"cloud_distance",
          "of the scene's size",
          Better::kLower,
          {MetricNeed::kCloud},
          [](const MetricInputs& inputs) {
            const double size = largest_side(inputs.true_surface);
            if (!(size > 0)) return absent_metric("the true surface has no extent");
            return one_value(median_cloud_distance(inputs.cloud, inputs.true_surface) / size);
          }};
}

}  // namespace

std::vector<Metric> cloud_metrics() { return {depth_scale_ratio_metric(), cloud_distance_metric()}; }

}  // namespace gld
