#include "gld/metrics/metric.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace gld {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

const std::string& what_is_missing(MetricNeed need) {
  static const std::vector<std::string> phrases{"there are no images to compare",
                                                "no network for perceptual distances was given",
                                                "the scene has no true depth",
                                                "no depth was predicted",
                                                "the scale of the predicted depth is unknown",
                                                "there is no cloud, or no true surface to compare it with",
                                                "no rays were predicted",
                                                "no cameras were estimated from the pictures",
                                                "no cameras were estimated from the sample",
                                                "the scale of the estimated cameras is unknown",
                                                "there is no depth of the true pictures to compare with",
                                                "no depth and cameras of all views were predicted",
                                                "there are no features of the views",
                                                "there are no features of the true pictures",
                                                "a view of the scene has no true depth",
                                                "there are no levels of the true pictures",
                                                "there are no latents to compare",
                                                "no photographs were carried into the target views",
                                                "there are no samples to compare"};
  return phrases.at(static_cast<size_t>(need));
}

bool needs_one(const Metric& metric, MetricNeed need) {
  return std::find(metric.needs.begin(), metric.needs.end(), need) != metric.needs.end();
}

}  // namespace

const std::string& better_name(Better better) {
  static const std::vector<std::string> names{"higher", "lower", "near 1"};
  return names.at(static_cast<size_t>(better));
}

bool MetricInputs::has(MetricNeed need) const {
  switch (need) {
    case MetricNeed::kImages:
      return true_images.defined() && images.defined();
    case MetricNeed::kPerceptualDistance:
      return static_cast<bool>(perceptual_distance);
    case MetricNeed::kTrueDepth:
      return true_depth.defined();
    case MetricNeed::kDepth:
      return depth.defined();
    case MetricNeed::kDepthScale:
      return depth_scale.has_value();
    case MetricNeed::kCloud:
      return cloud.defined() && true_surface.defined();
    case MetricNeed::kPhotoCameras:
      return !photo_cameras.empty();
    case MetricNeed::kEstimatedCameras:
      return !estimated_cameras.empty();
    case MetricNeed::kCameraScale:
      return camera_scale.has_value();
    case MetricNeed::kPseudoDepth:
      return pseudo_depth.defined();
    case MetricNeed::kViewGeometry:
      return view_images.defined() && view_depth.defined() && !estimated_cameras.empty();
    case MetricNeed::kViewFeatures:
      return view_features.defined();
    case MetricNeed::kTrueFeatures:
      return true_features.defined();
    case MetricNeed::kAllTrueDepth:
      return all_true_depth.defined();
    case MetricNeed::kTrueLevels:
      return !true_levels.empty();
    case MetricNeed::kLatents:
      return !latents.empty() && !true_latents.empty();
    case MetricNeed::kShownPixels:
      return shown.defined();
    case MetricNeed::kSamples:
      return true_images.defined() && samples.defined();
    case MetricNeed::kRays:
      return rays.defined() && !predicted_cameras.empty();
  }
  return false;
}

std::vector<Metric> metrics_of_levels(const std::function<Metric(int64_t level)>& of_level) {
  std::vector<Metric> metrics;
  for (int64_t level = 0; level < kLevelColumns; ++level) metrics.push_back(of_level(level));
  return metrics;
}

double MetricValue::mean() const {
  if (!per_view.defined()) return kNaN;
  return per_view.masked_select(per_view.isnan().logical_not()).mean().item<double>();
}

MetricValue absent_metric(std::string reason) {
  MetricValue value;
  value.absent = std::move(reason);
  return value;
}

MetricValue metric_of_views(const torch::Tensor& per_view, const std::string& reason_without_any) {
  if (per_view.isnan().all().item<bool>()) return absent_metric(reason_without_any);
  MetricValue value;
  value.per_view = per_view.to(torch::kCPU, torch::kFloat64);
  return value;
}

bool Metric::of_images() const { return needs_one(*this, MetricNeed::kImages) && !of_samples(); }

bool Metric::of_samples() const { return needs_one(*this, MetricNeed::kSamples); }

MetricValue measure(const Metric& metric, const MetricInputs& inputs) {
  for (const MetricNeed need : metric.needs) {
    if (inputs.has(need)) continue;
    const auto reason = inputs.missing.find(need);
    return absent_metric(reason == inputs.missing.end() ? what_is_missing(need) : reason->second);
  }
  return metric.compute(inputs);
}

MetricValue measure_images(const Metric& metric, const torch::Tensor& truth, const torch::Tensor& images) {
  MetricInputs inputs;
  inputs.true_images = truth;
  inputs.images = images;
  return measure(metric, inputs);
}

SceneStatistics statistics_over_scenes(const std::vector<double>& values) {
  SceneStatistics result;
  std::vector<double> finite;
  double sum = 0;
  for (const double value : values) {
    if (std::isinf(value)) ++result.infinite;
    if (!std::isfinite(value)) continue;
    sum += value;
    finite.push_back(value);
  }
  result.count = static_cast<int64_t>(finite.size());
  result.interval = {kNaN, kNaN};
  if (finite.empty()) {
    result.mean = result.deviation = kNaN;
    return result;
  }
  const auto count = static_cast<double>(result.count);
  result.mean = sum / count;
  double squares = 0;
  for (const double value : finite) squares += (value - result.mean) * (value - result.mean);
  result.deviation = std::sqrt(squares / count);
  if (finite.size() > 1) result.interval = bootstrap_interval({finite});
  return result;
}

}  // namespace gld
