#include "gld/metrics/energy_score.h"

#include "gld/base/error.h"
#include "gld/metrics/metric.h"
#include "gld/metrics/random_features.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <functional>
#include <limits>
#include <string>
#include <utility>

namespace gld {
namespace {

// Weights of the places of each map of a picture; they add up to 1 over all maps, so that a distance is a root mean
// square. Empty where nothing counts.
using PlaceWeights = std::vector<std::vector<double>>;

// One picture as it is compared: maps (channels, rows, columns), float32, contiguous.
using Maps = std::vector<torch::Tensor>;

// This makes maps of (3, height, width).
using MapsOf = std::function<Maps(const torch::Tensor&)>;

// Sums are in a fixed order, so that no bit depends on threads.
double squared_distance(const Maps& a, const Maps& b, const PlaceWeights& weights) {
  double sum = 0;
  std::vector<double> squares;
  for (size_t map = 0; map < a.size(); ++map) {
    const size_t places = weights[map].size();
    squares.assign(places, 0);
    const float* of_a = a[map].data_ptr<float>();
    const float* of_b = b[map].data_ptr<float>();
    for (int64_t channel = 0; channel < a[map].size(0); ++channel, of_a += places, of_b += places) {
      for (size_t i = 0; i < places; ++i) {
        const double difference = static_cast<double>(of_a[i]) - static_cast<double>(of_b[i]);
        squares[i] += difference * difference;
      }
    }
    for (size_t i = 0; i < places; ++i) sum += weights[map][i] * squares[i];
  }
  return sum;
}

double score_of_view(const torch::Tensor& truth, const torch::Tensor& samples, const MapsOf& maps_of,
                     const PlaceWeights& weights) {
  if (weights.empty()) return std::numeric_limits<double>::quiet_NaN();
  const Maps true_maps = maps_of(truth);
  const auto distance = [&](const Maps& a, const Maps& b) {
    return std::sqrt(squared_distance(a, b, weights));
  };
  double to_truth = 0, between = 0;
  int64_t pairs = 0;
  std::deque<Maps> earlier;
  for (int64_t sample = 0; sample < samples.size(0); ++sample) {
    Maps maps = maps_of(samples[sample]);
    to_truth += distance(maps, true_maps);
    for (const Maps& partner : earlier) between += distance(maps, partner);
    pairs += static_cast<int64_t>(earlier.size());
    earlier.push_back(std::move(maps));
    if (static_cast<int64_t>(earlier.size()) > kMostPartners) earlier.pop_front();
  }
  const double mean_to_truth = to_truth / static_cast<double>(samples.size(0));
  return pairs == 0 ? mean_to_truth : mean_to_truth - between / static_cast<double>(pairs) / 2;
}

void require_samples(const std::string& metric, const torch::Tensor& truth, const torch::Tensor& samples,
                     const torch::Tensor& pixels) {
  if (truth.dim() != 4 || truth.size(1) != 3 || truth.numel() == 0 || samples.dim() != 5 ||
      samples.size(0) == 0 || samples.sizes().slice(1) != truth.sizes()) {
    fail({metric, "images (views, 3, height, width) and samples of them (samples, views, 3, height, width)",
          c10::str(truth.sizes()) + " and " + c10::str(samples.sizes()), "give samples of the same views"});
  }
  if (pixels.defined() && (pixels.dim() != 3 || pixels.size(0) != truth.size(0) ||
                           pixels.sizes().slice(1) != truth.sizes().slice(2))) {
    fail({metric, "pixels (views, height, width) of the images", c10::str(pixels.sizes()),
          "choose among the pixels of " + c10::str(truth.sizes())});
  }
}

// Every map counts alike, and its places by their shares, (rows, columns), 0 to 1. numbers is how many of a place are
// averaged: the colours of a pixel, or 1 for features, whose vectors have length 1 and are compared whole.
PlaceWeights place_weights(const std::vector<torch::Tensor>& shares, int64_t numbers) {
  PlaceWeights weights;
  for (const torch::Tensor& of_map : shares) {
    const auto flat = of_map.to(torch::kCPU, torch::kFloat64).contiguous().view(-1);
    const double* first = flat.data_ptr<double>();
    std::vector<double> of_places(first, first + flat.numel());
    double sum = 0;
    for (const double share : of_places) sum += share;
    if (!(sum > 0)) return {};
    const double whole = sum * static_cast<double>(numbers * static_cast<int64_t>(shares.size()));
    for (double& share : of_places) share /= whole;
    weights.push_back(std::move(of_places));
  }
  return weights;
}

torch::Tensor counting_pixels(const torch::Tensor& truth, const torch::Tensor& pixels, int64_t view) {
  return pixels.defined() ? pixels[view].to(torch::kCPU, torch::kFloat64)
                          : torch::ones({truth.size(2), truth.size(3)}, torch::kFloat64);
}

torch::Tensor scores(const torch::Tensor& truth, const torch::Tensor& samples, const MapsOf& maps_of,
                     const std::function<PlaceWeights(int64_t view)>& weights_of) {
  const int64_t views = truth.size(0);
  torch::Tensor result = torch::empty({views}, torch::kFloat64);
  for (int64_t view = 0; view < views; ++view) {
    result[view] = score_of_view(truth[view], samples.select(1, view), maps_of, weights_of(view));
  }
  return result;
}

}  // namespace

torch::Tensor energy_score(const torch::Tensor& truth, const torch::Tensor& samples,
                           const torch::Tensor& pixels) {
  require_samples("energy score", truth, samples, pixels);
  const MapsOf colours = [](const torch::Tensor& picture) {
    return Maps{picture.to(torch::kCPU, torch::kFloat32).clamp(0, 1).contiguous()};
  };
  return scores(truth, samples, colours, [&](int64_t view) {
    return place_weights({counting_pixels(truth, pixels, view)}, truth.size(1));
  });
}

torch::Tensor energy_score_of_features(const torch::Tensor& truth, const torch::Tensor& samples,
                                       const torch::Tensor& pixels) {
  require_samples("energy score of features", truth, samples, pixels);
  const MapsOf features = [](const torch::Tensor& picture) {
    Maps maps;
    for (const auto& map : random_feature_maps(picture.unsqueeze(0))) maps.push_back(map[0].contiguous());
    return maps;
  };
  return scores(truth, samples, features, [&](int64_t view) {
    auto shares = counting_pixels(truth, pixels, view).view({1, 1, truth.size(2), truth.size(3)});
    std::vector<torch::Tensor> by_map;
    for (int64_t map = 0; map < kRandomFeatureMaps; ++map) {
      if (map > 0) {
        shares = torch::avg_pool2d(shares, {2, 2}, {2, 2}, /*padding=*/{0, 0}, /*ceil_mode=*/true,
                                   /*count_include_pad=*/false);
      }
      by_map.push_back(shares[0][0]);
    }
    return place_weights(by_map, 1);
  });
}

namespace {

using Score = torch::Tensor (*)(const torch::Tensor&, const torch::Tensor&, const torch::Tensor&);

struct ScoreMetric {
  std::string name;
  Score score;
  int64_t smallest_side;
};

MetricValue value_of(const ScoreMetric& metric, const MetricInputs& inputs, const torch::Tensor& pixels) {
  const auto& truth = inputs.true_images;
  if (std::min(truth.size(2), truth.size(3)) < metric.smallest_side) {
    return absent_metric("random features take images of at least 8 pixels");
  }
  if (pixels.defined() && truth.size(0) != pixels.size(0)) {
    return absent_metric("the images are not those of the target views");
  }
  return metric_of_views(metric.score(truth, inputs.samples, pixels),
                         pixels.defined() ? "no target view has such a pixel" : "the images are not finite");
}

Metric of_all_pixels(const ScoreMetric& metric) {
  return {metric.name,
          "",
          Better::kLower,
          {MetricNeed::kImages, MetricNeed::kSamples},
          [metric](const MetricInputs& inputs) { return value_of(metric, inputs, {}); }};
}

Metric of_seen_pixels(const ScoreMetric& metric) {
  return {metric.name + "_seen",
          "",
          Better::kLower,
          {MetricNeed::kImages, MetricNeed::kSamples, MetricNeed::kShownPixels},
          [metric](const MetricInputs& inputs) { return value_of(metric, inputs, inputs.shown); }};
}

Metric of_unseen_pixels(const ScoreMetric& metric) {
  return {
      metric.name + "_unseen",
      "",
      Better::kLower,
      {MetricNeed::kImages, MetricNeed::kSamples, MetricNeed::kShownPixels},
      [metric](const MetricInputs& inputs) { return value_of(metric, inputs, inputs.shown.logical_not()); }};
}

}  // namespace

std::vector<Metric> energy_score_metrics() {
  std::vector<Metric> metrics;
  for (const ScoreMetric& metric :
       {ScoreMetric{"energy_score", energy_score, 1},
        ScoreMetric{"energy_score_features", energy_score_of_features, kSmallestRandomFeatureSide}}) {
    metrics.push_back(of_all_pixels(metric));
    metrics.push_back(of_seen_pixels(metric));
    metrics.push_back(of_unseen_pixels(metric));
  }
  return metrics;
}

}  // namespace gld
