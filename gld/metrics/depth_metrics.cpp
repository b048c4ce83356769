#include "gld/metrics/depth_metrics.h"

#include "gld/base/error.h"
#include "gld/metrics/metric.h"

#include <limits>
#include <string>
#include <vector>

namespace gld {
namespace {

constexpr double kSmallestPrediction = 1e-3;
constexpr double kDeltaRatio = 1.25;

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
  // One factor a view, which also hides what views disagree about:
  kMedianPerView,
  kLeastSquaresPerView,
  kCameras,  // one factor a scene, of the similarity between predicted and true cameras; no true depth goes in
};

struct NamedScaling {
  DepthScaling scaling;
  const char* name;  // as metrics end
};

const std::vector<NamedScaling>& depth_scalings() {
  static const std::vector<NamedScaling> scalings{
      {DepthScaling::kNone, "unscaled"},
      {DepthScaling::kMedian, "median_scaled"},
      {DepthScaling::kMedianPerView, "median_scaled_per_view"},
      {DepthScaling::kLeastSquaresPerView, "least_squares_scaled_per_view"},
      {DepthScaling::kCameras, "camera_scaled"}};
  return scalings;
}

struct NamedError {
  torch::Tensor DepthErrors::*values;
  const char* name;
  bool has_length;  // is a length, in the unit of the depth, and no ratio
  Better better;
};

const NamedError kAbsRel{&DepthErrors::abs_rel, "abs_rel", false, Better::kLower};
const NamedError kSqRel{&DepthErrors::sq_rel, "sq_rel", true, Better::kLower};
const NamedError kRmse{&DepthErrors::rmse, "rmse", true, Better::kLower};
const NamedError kDelta1{&DepthErrors::delta1, "delta1", false, Better::kHigher};
const NamedError kDelta2{&DepthErrors::delta2, "delta2", false, Better::kHigher};
const NamedError kDelta3{&DepthErrors::delta3, "delta3", false, Better::kHigher};

// Returns a factor for each view, (views, 1, 1) or of one element; it is NaN for a view without a pixel to align.
torch::Tensor depth_factors(const MetricInputs& inputs, const torch::Tensor& truth,
                            const torch::Tensor& depth, DepthScaling scaling) {
  switch (scaling) {
    case DepthScaling::kNone:
      return torch::full({1}, *inputs.depth_scale, torch::kFloat64);
    case DepthScaling::kCameras:
      return torch::full({1}, *inputs.camera_scale, torch::kFloat64);
    case DepthScaling::kMedian:
      return torch::full({1}, median_depth_scale(truth, depth), torch::kFloat64);
    case DepthScaling::kMedianPerView:
    case DepthScaling::kLeastSquaresPerView:
      break;
  }
  auto factors =
      torch::full({truth.size(0), 1, 1}, std::numeric_limits<double>::quiet_NaN(), torch::kFloat64);
  for (int64_t view = 0; view < truth.size(0); ++view) {
    const auto one_truth = truth.narrow(0, view, 1), one_depth = depth.narrow(0, view, 1);
    if (!(valid_mask(one_truth) & valid_mask(one_depth)).any().item<bool>()) continue;
    factors[view] = scaling == DepthScaling::kMedianPerView ? median_depth_scale(one_truth, one_depth)
                                                            : least_squares_depth_scale(one_truth, one_depth);
  }
  return factors;
}

MetricValue depth_value(const MetricInputs& inputs, const NamedError& error, DepthScaling scaling) {
  const auto truth = inputs.true_depth.to(torch::kCPU);
  const auto depth = inputs.depth.to(torch::kCPU, torch::kFloat64);
  const std::string no_pixel = "no pixel of a target view has a true depth";
  if (!valid_mask(truth).any().item<bool>()) return absent_metric(no_pixel);
  if (!depth.isfinite().all().item<bool>()) return absent_metric("the predicted depth is not finite");
  const bool from_truth = scaling != DepthScaling::kNone && scaling != DepthScaling::kCameras;
  if (from_truth && !(valid_mask(truth) & valid_mask(depth)).any().item<bool>()) {
    return absent_metric("no predicted depth is positive where the true one is known");
  }
  const auto scaled = depth * depth_factors(inputs, truth, depth, scaling);
  return metric_of_views(depth_errors(truth, scaled).*error.values, no_pixel);
}

Metric depth_metric(const NamedError& error, const NamedScaling& scaled) {
  Metric metric;
  metric.name = std::string("depth_") + error.name + "_" + scaled.name;
  metric.unit = error.has_length ? "scene units" : "";
  metric.better = error.better;
  metric.needs = {MetricNeed::kTrueDepth, MetricNeed::kDepth};
  if (scaled.scaling == DepthScaling::kNone) metric.needs.push_back(MetricNeed::kDepthScale);
  if (scaled.scaling == DepthScaling::kCameras) metric.needs.push_back(MetricNeed::kCameraScale);
  metric.compute = [error, scaling = scaled.scaling](const MetricInputs& inputs) {
    return depth_value(inputs, error, scaling);
  };
  return metric;
}

// Against what the same model says of the true pictures, whose unit is the same: nothing is aligned (GLD's Table 2).
Metric pseudo_depth_metric(const NamedError& error) {
  Metric metric;
  metric.name = std::string("pseudo_depth_") + error.name;
  metric.unit = error.has_length ? "model units" : "";
  metric.better = error.better;
  metric.needs = {MetricNeed::kPseudoDepth, MetricNeed::kDepth};
  metric.compute = [error](const MetricInputs& inputs) {
    const torch::Tensor& of_head = inputs.head_depth.defined() ? inputs.head_depth : inputs.depth;
    const auto depth = of_head.to(torch::kCPU, torch::kFloat64);
    if (!depth.isfinite().all().item<bool>()) return absent_metric("the predicted depth is not finite");
    return metric_of_views(depth_errors(inputs.pseudo_depth.to(torch::kCPU), depth).*error.values,
                           "the depth of the true pictures is nowhere positive");
  };
  return metric;
}

}  // namespace

DepthErrors depth_errors(const torch::Tensor& truth, const torch::Tensor& prediction) {
  require_same_maps(truth, prediction);
  const int64_t views = truth.size(0);
  DepthErrors errors;
  errors.abs_rel = torch::full({views}, std::numeric_limits<double>::quiet_NaN(), torch::kFloat64);
  errors.sq_rel = errors.abs_rel.clone();
  errors.rmse = errors.abs_rel.clone();
  errors.delta1 = errors.abs_rel.clone();
  errors.delta2 = errors.abs_rel.clone();
  errors.delta3 = errors.abs_rel.clone();
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
    const auto ratio = torch::maximum(positive / t, t / positive);
    const auto share_below = [&](double limit) { return (ratio < limit).to(torch::kFloat64).mean(); };
    // A scale that is not known makes the errors unknown, and the deltas with them.
    if (p.isnan().any().item<bool>()) continue;
    errors.delta1[view] = share_below(kDeltaRatio);
    errors.delta2[view] = share_below(kDeltaRatio * kDeltaRatio);
    errors.delta3[view] = share_below(kDeltaRatio * kDeltaRatio * kDeltaRatio);
  }
  return errors;
}

double median_depth_scale(const torch::Tensor& truth, const torch::Tensor& prediction) {
  const auto pairs = pairs_to_align(truth, prediction);
  return (pairs.truth / pairs.prediction).median().item<double>();
}

double least_squares_depth_scale(const torch::Tensor& truth, const torch::Tensor& prediction) {
  const auto pairs = pairs_to_align(truth, prediction);
  // Predictions are in units of the largest one, so that squares neither overflow nor vanish.
  const auto unit = pairs.prediction.max();
  const auto p = pairs.prediction / unit;
  return ((p * pairs.truth).sum() / p.square().sum() / unit).item<double>();
}

// Returns every error under every way to scale.
std::vector<Metric> depth_metrics() {
  std::vector<Metric> metrics;
  for (const NamedScaling& scaling : depth_scalings()) {
    for (const NamedError& error : {kAbsRel, kSqRel, kRmse, kDelta1, kDelta2, kDelta3}) {
      metrics.push_back(depth_metric(error, scaling));
    }
  }
  for (const NamedError& error : {kAbsRel, kRmse, kDelta1}) metrics.push_back(pseudo_depth_metric(error));
  return metrics;
}

}  // namespace gld
