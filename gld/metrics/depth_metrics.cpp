#include "gld/metrics/depth_metrics.h"

#include "gld/base/error.h"
#include "gld/metrics/metric.h"

#include <limits>
#include <string>
#include <vector>

namespace gld {
namespace {

constexpr double kSmallestPrediction = 1e-3;
constexpr double kDelta1 = 1.25;

void require_same_maps(const torch::Tensor& truth, const torch::Tensor& prediction) {
  if (truth.dim() != 3 || truth.sizes() != prediction.sizes()) {
    fail({"depth metrics", "two batches of depth maps (views, height, width) of one shape",
          c10::str(truth.sizes()) + " and " + c10::str(prediction.sizes()),
          "resize the prediction to the truth"});
  }
}

torch::Tensor valid_mask(const torch::Tensor& truth) { return torch::isfinite(truth) & (truth > 0); }

struct ValidPairs {
  torch::Tensor truth;       // (n), float64
  torch::Tensor prediction;  // (n), float64
};

ValidPairs pairs_to_align(const torch::Tensor& truth, const torch::Tensor& prediction) {
  require_same_maps(truth, prediction);
  const auto mask = valid_mask(truth) & valid_mask(prediction);
  ValidPairs pairs{truth.masked_select(mask).to(torch::kFloat64),
                   prediction.masked_select(mask).to(torch::kFloat64)};
  if (pairs.truth.numel() == 0) {
    fail({"depth alignment", "pixels with a positive finite depth in truth and prediction", "none",
          "check the depth maps and their validity masks"});
  }
  return pairs;
}

enum class DepthScaling {
  kNone,    // the model's depth in the scene's unit, as gld sample writes it: nothing of the truth goes in
  kMedian,  // one factor a scene, the median of truth / prediction over its target views
};

template <torch::Tensor DepthErrors::*error>
MetricValue depth_value(const MetricInputs& inputs, DepthScaling scaling) {
  const auto truth = inputs.true_depth.to(torch::kCPU);
  const auto depth = inputs.depth.to(torch::kCPU, torch::kFloat64);
  const std::string no_pixel = "no pixel of a target view has a true depth";
  if (!valid_mask(truth).any().item<bool>()) return absent_metric(no_pixel);
  if (!depth.isfinite().all().item<bool>()) return absent_metric("the predicted depth is not finite");
  double scale = 1;
  if (scaling == DepthScaling::kNone) {
    scale = *inputs.depth_scale;
  } else {
    if (!(valid_mask(truth) & valid_mask(depth)).any().item<bool>()) {
      return absent_metric("no predicted depth is positive where the true one is known");
    }
    scale = median_depth_scale(truth, depth);
  }
  return metric_of_views(depth_errors(truth, depth * scale).*error, no_pixel);
}

template <torch::Tensor DepthErrors::*error>
Metric depth_metric(const std::string& name, const std::string& unit, Better better, DepthScaling scaling) {
  Metric metric{name, unit, better, {MetricNeed::kTrueDepth, MetricNeed::kDepth}, nullptr};
  if (scaling == DepthScaling::kNone) metric.needs.push_back(MetricNeed::kDepthScale);
  metric.compute = [scaling](const MetricInputs& inputs) { return depth_value<error>(inputs, scaling); };
  return metric;
}

const std::string kSceneUnit = "scene units";

}  // namespace

DepthErrors depth_errors(const torch::Tensor& truth, const torch::Tensor& prediction) {
  require_same_maps(truth, prediction);
  const int64_t views = truth.size(0);
  DepthErrors errors;
  errors.abs_rel = torch::full({views}, std::numeric_limits<double>::quiet_NaN(), torch::kFloat64);
  errors.sq_rel = errors.abs_rel.clone();
  errors.rmse = errors.abs_rel.clone();
  errors.delta1 = errors.abs_rel.clone();
  errors.valid_pixels = torch::zeros({views}, torch::kInt64);
  for (int64_t view = 0; view < views; ++view) {
    const auto mask = valid_mask(truth[view]);
    const auto t = truth[view].masked_select(mask).to(torch::kFloat64);
    const auto p = prediction[view].masked_select(mask).to(torch::kFloat64);
    errors.valid_pixels[view] = t.numel();
    if (t.numel() == 0) continue;
    const auto difference = p - t;
    errors.abs_rel[view] = (difference.abs() / t).mean();
    errors.sq_rel[view] = (difference.square() / t).mean();
    errors.rmse[view] = difference.square().mean().sqrt();
    const auto positive = p.clamp_min(kSmallestPrediction);
    errors.delta1[view] = (torch::maximum(positive / t, t / positive) < kDelta1).to(torch::kFloat64).mean();
  }
  return errors;
}

double median_depth_scale(const torch::Tensor& truth, const torch::Tensor& prediction) {
  const auto pairs = pairs_to_align(truth, prediction);
  return (pairs.truth / pairs.prediction).median().item<double>();
}

double least_squares_depth_scale(const torch::Tensor& truth, const torch::Tensor& prediction) {
  const auto pairs = pairs_to_align(truth, prediction);
  // In units of the largest prediction, so that squares neither overflow nor vanish.
  const auto unit = pairs.prediction.max();
  const auto p = pairs.prediction / unit;
  return ((p * pairs.truth).sum() / p.square().sum() / unit).item<double>();
}

Metric depth_abs_rel_unscaled_metric() {
  return depth_metric<&DepthErrors::abs_rel>("depth_abs_rel_unscaled", "", Better::kLower,
                                             DepthScaling::kNone);
}

Metric depth_sq_rel_unscaled_metric() {
  return depth_metric<&DepthErrors::sq_rel>("depth_sq_rel_unscaled", kSceneUnit, Better::kLower,
                                            DepthScaling::kNone);
}

Metric depth_rmse_unscaled_metric() {
  return depth_metric<&DepthErrors::rmse>("depth_rmse_unscaled", kSceneUnit, Better::kLower,
                                          DepthScaling::kNone);
}

Metric depth_delta1_unscaled_metric() {
  return depth_metric<&DepthErrors::delta1>("depth_delta1_unscaled", "", Better::kHigher,
                                            DepthScaling::kNone);
}

Metric depth_abs_rel_median_scaled_metric() {
  return depth_metric<&DepthErrors::abs_rel>("depth_abs_rel_median_scaled", "", Better::kLower,
                                             DepthScaling::kMedian);
}

Metric depth_sq_rel_median_scaled_metric() {
  return depth_metric<&DepthErrors::sq_rel>("depth_sq_rel_median_scaled", kSceneUnit, Better::kLower,
                                            DepthScaling::kMedian);
}

Metric depth_rmse_median_scaled_metric() {
  return depth_metric<&DepthErrors::rmse>("depth_rmse_median_scaled", kSceneUnit, Better::kLower,
                                          DepthScaling::kMedian);
}

Metric depth_delta1_median_scaled_metric() {
  return depth_metric<&DepthErrors::delta1>("depth_delta1_median_scaled", "", Better::kHigher,
                                            DepthScaling::kMedian);
}

}  // namespace gld
