#include "gld/photogrammetry/scale_consensus.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <map>
#include <numeric>
#include <random>

namespace gld {
namespace {

constexpr double kDepthDeviation = 0.12;  // of the logarithm of predicted depth, from point to point
constexpr double kBelieved = 0.5;         // of an observation to be right
constexpr double kAlike = 0.2;            // logarithms this close are alike
constexpr double kDecided = 0.6;  // share of an observation's density near its mode that makes it decided
constexpr int64_t kFewestObservations = 20;
constexpr size_t kFewestBlocks = 2;
constexpr double kViewsWithin =
    0.4;  // a view's own maximum is looked for this near to that of all, in logarithms
constexpr int kResamplings = 200;

double median_of(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Returns where the maximum between two candidates (both included) lies, in candidates: the vertex of the parabola
// through the largest value and its neighbours.
double peak(const std::vector<double>& values, size_t first, size_t last) {
  const auto begin = values.begin();
  const auto best = static_cast<size_t>(std::max_element(begin + static_cast<std::ptrdiff_t>(first),
                                                         begin + static_cast<std::ptrdiff_t>(last) + 1) -
                                        begin);
  if (best == 0 || best + 1 == values.size()) return static_cast<double>(best);
  const double before = values[best - 1], here = values[best], after = values[best + 1];
  const double bend = before - 2 * here + after;
  const double shift = bend < 0 ? 0.5 * (before - after) / bend : 0;
  return static_cast<double>(best) + std::clamp(shift, -0.5, 0.5);
}

double peak(const std::vector<double>& values) { return peak(values, 0, values.size() - 1); }

double square(double value) { return value * value; }

// The mean of estimates with their variances, which also scatter between themselves.
struct WeightedMean {
  double mean = 0;
  double deviation = 0;
};

WeightedMean random_effects_mean(const std::vector<double>& values, const std::vector<double>& variances) {
  const auto fixed = [&](double between) {
    double weights = 0, sum = 0;
    for (size_t i = 0; i < values.size(); ++i) {
      const double weight = 1 / (variances[i] + between);
      weights += weight;
      sum += weight * values[i];
    }
    return WeightedMean{sum / weights, 1 / std::sqrt(weights)};
  };
  double weights = 0, squares = 0, scatter = 0;
  const double mean = fixed(0).mean;
  for (size_t i = 0; i < values.size(); ++i) {
    weights += 1 / variances[i];
    squares += square(1 / variances[i]);
    scatter += square(values[i] - mean) / variances[i];
  }
  const double free = static_cast<double>(values.size()) - 1;
  const double between = free > 0 ? (scatter - free) / (weights - squares / weights) : 0;
  return fixed(std::max(0.0, between));
}

void add_to(std::vector<double>& sum, const std::vector<double>& values) {
  for (size_t i = 0; i < sum.size(); ++i) sum[i] += values[i];
}

}  // namespace

ScaleCandidates ScaleCandidates::between(double lowest, double highest) {
  ScaleCandidates candidates;
  candidates.log_first = std::log(lowest);
  const double steps = std::ceil((std::log(highest) - candidates.log_first) / candidates.log_step);
  candidates.count = 1 + static_cast<int64_t>(std::clamp(steps, 1.0, 1000.0));
  return candidates;
}

ScaleConsensus::ScaleConsensus(const ScaleCandidates& candidates) : candidates_(candidates) {
  const auto reach = static_cast<int>(std::ceil(3 * kDepthDeviation / candidates.log_step));
  double sum = 0;
  for (int i = -reach; i <= reach; ++i) {
    const double off = i * candidates.log_step / kDepthDeviation;
    kernel_.push_back(std::exp(-0.5 * off * off));
    sum += kernel_.back();
  }
  for (double& value : kernel_) value /= sum;
}

ScaleConsensus::Likelihood& ScaleConsensus::likelihood_of(const ObservedPart& part) {
  // Observations come part by part.
  const auto known = std::find_if(blocks_.rbegin(), blocks_.rend(), [&](const Block& block) {
    return block.view == part.view && block.number == part.block;
  });
  if (known != blocks_.rend()) return known->likelihood;
  blocks_.push_back({part.view, part.block, Likelihood(static_cast<size_t>(candidates_.count), 0.0)});
  return blocks_.back().likelihood;
}

void ScaleConsensus::add_blurred(const std::vector<double>& blurred, const ObservedPart& part) {
  Likelihood& sums = likelihood_of(part);
  const auto count = static_cast<double>(candidates_.count);
  for (size_t i = 0; i < sums.size(); ++i) {
    sums[i] += std::log(1 - kBelieved + kBelieved * count * blurred[i]);
  }
  ++observations_;
}

void ScaleConsensus::add(const std::vector<float>& density, const ObservedPart& part) {
  const auto count = static_cast<std::ptrdiff_t>(density.size());
  const double sum = std::accumulate(density.begin(), density.end(), 0.0);
  const auto mode = std::max_element(density.begin(), density.end()) - density.begin();
  const auto near = static_cast<std::ptrdiff_t>(std::lround(kAlike / candidates_.log_step));
  const double near_mode = std::accumulate(density.begin() + std::max<std::ptrdiff_t>(0, mode - near),
                                           density.begin() + std::min(count, mode + near + 1), 0.0);
  if (near_mode > kDecided * sum) decided_.push_back(candidates_.log_scale(static_cast<double>(mode)));
  const auto reach = static_cast<std::ptrdiff_t>(kernel_.size() / 2);
  std::vector<double> blurred(density.size(), 0.0);
  for (std::ptrdiff_t i = 0; i < count; ++i) {
    const auto first = std::max<std::ptrdiff_t>(0, i - reach), last = std::min(count - 1, i + reach);
    double value = 0, weights = 0;
    for (std::ptrdiff_t j = first; j <= last; ++j) {
      const double weight = kernel_[static_cast<size_t>(j - i + reach)];
      weights += weight;
      value += weight * density[static_cast<size_t>(j)];
    }
    // Candidates that are cut off go on beyond the ends: as if nothing were there, the blur would move a maximum from
    // the end inwards.
    blurred[static_cast<size_t>(i)] = value / (candidates_.cut_off ? weights * sum : sum);
  }
  add_blurred(blurred, part);
}

void ScaleConsensus::add_ratio(double ratio, const ObservedPart& part) {
  const double log_ratio = std::log(ratio);
  const double norm = candidates_.log_step / (kDepthDeviation * std::sqrt(2 * std::acos(-1.0)));
  std::vector<double> blurred(static_cast<size_t>(candidates_.count));
  for (size_t i = 0; i < blurred.size(); ++i) {
    const double off = (candidates_.log_scale(static_cast<double>(i)) - log_ratio) / kDepthDeviation;
    blurred[i] = norm * std::exp(-0.5 * off * off);
  }
  decided_.push_back(log_ratio);
  add_blurred(blurred, part);
}

std::optional<DepthScale> ScaleConsensus::estimate(const std::string& estimator,
                                                   double smallest_deviation) const {
  if (observations_ < kFewestObservations || blocks_.size() < kFewestBlocks) return std::nullopt;
  std::map<size_t, std::vector<const Likelihood*>> views;
  std::vector<const Likelihood*> all;
  for (const Block& block : blocks_) {
    views[block.view].push_back(&block.likelihood);
    all.push_back(&block.likelihood);
  }
  const auto count = static_cast<size_t>(candidates_.count);
  const auto sum_of = [&](const std::vector<const Likelihood*>& parts) {
    Likelihood sum(count, 0.0);
    for (const Likelihood* part : parts) add_to(sum, *part);
    return sum;
  };
  std::mt19937_64 draws(1);
  const auto resampled_sum = [&](const std::vector<const Likelihood*>& parts) {
    Likelihood sum(count, 0.0);
    for (size_t i = 0; i < parts.size(); ++i) add_to(sum, *parts[draws() % parts.size()]);
    return sum;
  };

  // This finds where to look, and how often other blocks would have said to look elsewhere.
  const double middle = peak(sum_of(all));
  const bool at_an_end = middle < 1 || middle > static_cast<double>(count) - 2;
  if (candidates_.cut_off && at_an_end) return std::nullopt;
  std::vector<double> off;
  off.reserve(kResamplings);
  for (int i = 0; i < kResamplings; ++i) {
    off.push_back(candidates_.log_step * std::abs(peak(resampled_sum(all)) - middle));
  }
  std::sort(off.begin(), off.end());
  const double usual_off = off[static_cast<size_t>(0.95 * kResamplings)];

  const double reach = kViewsWithin / candidates_.log_step;
  const auto first = static_cast<size_t>(std::max(0.0, std::floor(middle - reach)));
  const auto last = std::min(count - 1, static_cast<size_t>(std::ceil(middle + reach)));
  std::vector<double> values, variances;
  for (const auto& [view, parts] : views) {
    const double value = peak(sum_of(parts), first, last);
    double variance = 0;
    for (int i = 0; i < kResamplings; ++i) {
      variance += square(peak(resampled_sum(parts), first, last) - value) / kResamplings;
    }
    // One block cannot tell how sure it is.
    if (parts.size() < kFewestBlocks) variance = square(reach);
    values.push_back(candidates_.log_scale(value));
    variances.push_back(square(candidates_.log_step) * variance + square(smallest_deviation));
  }
  const WeightedMean mean = random_effects_mean(values, variances);
  const double log_scale = mean.mean;
  const double width = std::max(2 * mean.deviation, usual_off);

  DepthScale estimate;
  estimate.estimator = estimator;
  estimate.scale = std::exp(log_scale);
  estimate.low = std::exp(log_scale - width);
  estimate.high = std::exp(log_scale + width);
  std::vector<double> residuals;
  for (const double value : decided_) residuals.push_back(std::abs(value - log_scale));
  estimate.residual = residuals.empty() ? std::log(estimate.high / estimate.low) : median_of(residuals);
  return estimate;
}

}  // namespace gld
