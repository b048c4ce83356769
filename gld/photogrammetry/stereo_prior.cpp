#include "gld/photogrammetry/stereo_prior.h"

#include "gld/photogrammetry/depth_between.h"
#include "gld/photogrammetry/percentile.h"
#include "gld/photogrammetry/window_sums.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gld {
namespace {

// The prior: a correlation lower by kCorrelationOfPrior is one unit of log likelihood, at most kMostOfPrior of them,
// fading with its spread beyond kGoodPrior.
constexpr double kCorrelationOfPrior = 0.1;
constexpr double kMostOfPrior = 4;
constexpr double kGoodPrior = 0.1;
constexpr double kLeastSpread = 0.01;
// What counts at most of a confident pixel's distance from the prior, and where distances count as wrong matches, in
// spreads of the prior.
constexpr double kMostOfSpread = 3, kFarCertain = 8, kFarUncertain = 3;
// A prior that is off by more does not widen the depths that are looked at.
constexpr double kUsablePrior = 0.25;
// Depth that the photographs are not sure of: the least standard deviation of its logarithm.
constexpr double kLeastUncertain = 0.05;

// The middle of the shortest interval that holds half of the values, and the standard deviation of the normal
// distribution that has such an interval: up to a half of wrong matches does little to them.
struct ShortestHalf {
  double middle = 0;
  double deviation = 0;

  explicit ShortestHalf(std::vector<double>& values) {
    std::sort(values.begin(), values.end());
    const size_t half = values.size() / 2;
    double length = std::numeric_limits<double>::infinity();
    for (size_t first = 0; first + half < values.size(); ++first) {
      if (values[first + half] - values[first] >= length) continue;
      length = values[first + half] - values[first];
      middle = 0.5 * (values[first + half] + values[first]);
    }
    deviation = 0.5 * length / 0.6745;
  }
};

// Returns the logarithm of photographs' depth over the prior as the confident pixels about each pixel say, wide windows
// first; it falls to 0 where there are none.
std::vector<double> local_correction(const StereoDepth& found, const std::vector<float>& log_prior,
                                     double spread) {
  const int64_t width = found.depth.width, height = found.depth.height;
  std::vector<double> correction(log_prior.size(), 0);
  for (const int64_t share : {4, 12, 36}) {
    std::vector<double> weights(log_prior.size(), 0), rest(log_prior.size(), 0);
    for (size_t i = 0; i < log_prior.size(); ++i) {
      if (found.confidence.values[i] < kConfidentStereo || !std::isfinite(log_prior[i])) continue;
      weights[i] = static_cast<double>(found.confidence.values[i]);
      const double off =
          std::log(static_cast<double>(found.depth.values[i])) - static_cast<double>(log_prior[i]);
      rest[i] =
          weights[i] * (std::clamp(off, -kMostOfSpread * spread, kMostOfSpread * spread) - correction[i]);
    }
    const int64_t radius = std::max<int64_t>(2, std::max(width, height) / share / 2);
    window_sums(width, height, radius, weights);
    window_sums(width, height, radius, rest);
    // Confident pixels count half where they are as many as a twentieth of the window.
    const double doubt = 0.05 * static_cast<double>((2 * radius + 1) * (2 * radius + 1));
    for (size_t i = 0; i < correction.size(); ++i) correction[i] += rest[i] / (weights[i] + doubt);
  }
  return correction;
}

}  // namespace

std::vector<float> prior_at(const PicturedView& view, const StereoPicture& picture) {
  std::vector<float> result(static_cast<size_t>(picture.width * picture.height), 0.0F);
  if (view.depth.values.empty()) return {};
  const double columns = static_cast<double>(view.depth.width) / static_cast<double>(picture.width);
  const double rows = static_cast<double>(view.depth.height) / static_cast<double>(picture.height);
  for (int64_t y = 0; y < picture.height; ++y) {
    for (int64_t x = 0; x < picture.width; ++x) {
      result[static_cast<size_t>(y * picture.width + x)] =
          depth_between(view.depth, (static_cast<double>(x) + 0.5) * columns - 0.5,
                        (static_cast<double>(y) + 0.5) * rows - 0.5);
    }
  }
  return result;
}

std::optional<PriorAgreement> prior_agreement(const std::vector<StereoDepth>& found,
                                              const std::vector<std::vector<float>>& priors) {
  bool any = false;
  size_t asked = 0;
  std::vector<double> ratios, others;
  for (size_t view = 0; view < found.size(); ++view) {
    any = any || !priors[view].empty();
    asked += priors[view].size();
    for (size_t i = 0; i < priors[view].size(); ++i) {
      if (!PlanarDepth::known(priors[view][i]) || !PlanarDepth::known(found[view].depth.values[i])) continue;
      const double ratio =
          std::log(static_cast<double>(found[view].depth.values[i]) / static_cast<double>(priors[view][i]));
      (found[view].confidence.values[i] >= kConfidentStereo ? ratios : others).push_back(ratio);
    }
  }
  if (!any) return std::nullopt;
  PriorAgreement result;
  if (hardly_any(ratios.size(), asked)) return result;
  result.pixels = static_cast<int64_t>(ratios.size());
  const ShortestHalf half(ratios);
  result.scale = std::exp(half.middle);
  result.spread = half.deviation;
  // The prior's own error is in that of the others too.
  if (others.size() > 2) {
    const double spread = 0.5 * (percentile(others, 0.84) - percentile(others, 0.16));
    result.uncertain = std::sqrt(std::max(0.0, spread * spread - result.spread * result.spread));
  }
  result.uncertain = std::max(result.uncertain, kLeastUncertain);
  return result;
}

ScaledPrior scaled_prior(const std::vector<float>& prior, const PriorAgreement& agreement) {
  ScaledPrior scaled;
  scaled.log_depth.resize(prior.size());
  for (size_t i = 0; i < prior.size(); ++i) {
    scaled.log_depth[i] = PlanarDepth::known(prior[i])
                              ? static_cast<float>(std::log(agreement.scale * static_cast<double>(prior[i])))
                              : std::numeric_limits<float>::quiet_NaN();
  }
  const double spread = std::max(agreement.spread, kLeastSpread);
  const double believed =
      kCorrelationOfPrior * kDearestMatch / (1 + (spread / kGoodPrior) * (spread / kGoodPrior));
  scaled.steepness = believed / (2 * spread * spread);
  scaled.dearest = kMostOfPrior * believed;
  return scaled;
}

bool widens_range(const PriorAgreement& agreement) { return agreement.spread < kUsablePrior; }

void put_prior_in(StereoDepth& found, const SweptView& swept, const PriorAgreement& agreement) {
  const double spread = std::max(agreement.spread, kLeastSpread);
  const double prior_variance = spread * spread;
  const std::vector<double> correction = local_correction(found, swept.prior.log_depth, spread);
  for (size_t i = 0; i < correction.size(); ++i) {
    const auto prior = static_cast<double>(swept.prior.log_depth[i]);
    if (!std::isfinite(prior)) continue;
    float& depth = found.depth.values[i];
    const double plane = 0.5 * swept.planes.step * static_cast<double>(depth);
    const auto confidence = static_cast<double>(found.confidence.values[i]);
    const double sure = plane * plane + 1e-6, unsure = agreement.uncertain * agreement.uncertain;
    // The variance lies between both by confidence, on a scale of logarithms.
    const double variance = std::exp(std::min(1.0, confidence / static_cast<double>(kConfidentStereo)) *
                                     std::log(sure / unsure)) *
                            unsure;
    const double other = prior + correction[i];
    const double off = std::log(static_cast<double>(depth)) - other;
    // Wrong matches are farther off than any prior of that spread is; those that are certain are believed longer.
    const double far =
        off / (spread * (confidence >= static_cast<double>(kConfidentStereo) ? kFarCertain : kFarUncertain));
    const double weight = prior_variance / (prior_variance + variance) / (1 + far * far * far * far);
    depth = std::max(static_cast<float>(std::exp(other + weight * off)), found.least.values[i]);
  }
}

void take_prior(StereoDepth& result, const std::vector<float>& prior, double scale) {
  for (size_t i = 0; i < prior.size(); ++i) {
    result.depth.values[i] = PlanarDepth::known(prior[i]) ? static_cast<float>(scale) * prior[i] : 0.0F;
    result.confidence.values[i] = 0;
    result.least.values[i] = 0;
    if (result.doubt[i] == StereoDoubt::kNone) result.doubt[i] = StereoDoubt::kAmbiguous;
  }
}

}  // namespace gld
