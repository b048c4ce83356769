#include "gld/metrics/depth_metrics.h"

#include "gld/base/error.h"

#include <limits>
#include <string>
#include <vector>

namespace gld {
namespace {

constexpr double kSmallestPrediction = 1e-3;  // metres
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

}  // namespace

DepthErrors depth_errors(const torch::Tensor& truth, const torch::Tensor& prediction) {
  require_same_maps(truth, prediction);
  const int64_t views = truth.size(0);
  DepthErrors errors;
  errors.abs_rel = torch::full({views}, std::numeric_limits<double>::quiet_NaN(), torch::kFloat64);
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

}  // namespace gld
