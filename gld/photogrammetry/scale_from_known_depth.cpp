#include "gld/photogrammetry/scale_from_known_depth.h"

#include "gld/photogrammetry/scale_consensus.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <set>
#include <utility>

namespace gld {
namespace {

constexpr int64_t kBlocksASide = 4;
constexpr int64_t kSamplesASide = 48;  // of measured depth
constexpr size_t kMostPoints = 20000;
constexpr double kKnownDepthDeviation = 0.01;

struct Ratio {
  double value = 1;  // known depth over predicted depth
  ObservedPart part;
};

// right and down are of the picture, from 0 to 1. Returns 0 where the predicted depth is not known there.
float depth_at(const PlanarDepth& depth, double right, double down) {
  const auto column =
      std::min(depth.width - 1, static_cast<int64_t>(right * static_cast<double>(depth.width)));
  const auto row = std::min(depth.height - 1, static_cast<int64_t>(down * static_cast<double>(depth.height)));
  const float value = depth.values[static_cast<size_t>(row * depth.width + column)];
  return std::isfinite(value) && value > 0 ? value : 0.0F;
}

ObservedPart part_of(size_t view, double right, double down) {
  const auto cell = [](double share) {
    return std::min(kBlocksASide - 1, static_cast<int64_t>(share * static_cast<double>(kBlocksASide)));
  };
  return {view, static_cast<size_t>(cell(down) * kBlocksASide + cell(right))};
}

// Known depth is exact, so that what the fit leaves is how far the predicted depth has another shape: places that are
// known by chance then say another scale than the rest of what is seen. Of the places of one view so many are taken
// to be independent: an error of a network's depth is one of a wall, or of a half of the picture.
constexpr double kIndependentPlaces = 2;

// seen is the share of these views in which depth is known. The mean of k of K independent places of deviation s is off
// that of all by s sqrt(1 / k - 1 / K), with k = seen K: s sqrt((1 / seen - 1) / K). Where half and more is known it
// counts as half: what is known is known by texture, which is no fair draw.
DepthScale widened_by_shape(DepthScale estimate, size_t views, double seen) {
  const double places = kIndependentPlaces * static_cast<double>(views);
  // 1.4826 times the median distance is the deviation of a normal distribution.
  const double log_deviation = 1.4826 * estimate.residual * std::sqrt((1 / std::min(seen, 0.5) - 1) / places);
  estimate.low = std::min(estimate.low, estimate.scale * std::exp(-2 * log_deviation));
  estimate.high = std::max(estimate.high, estimate.scale * std::exp(2 * log_deviation));
  return estimate;
}

// `known` of the `parts` of each of `views` views, together, have a ratio.
std::optional<DepthScale> agreed(const std::vector<Ratio>& ratios, size_t views, size_t known, int64_t parts,
                                 const std::string& estimator) {
  if (ratios.empty()) return std::nullopt;
  std::vector<double> sorted;
  sorted.reserve(ratios.size());
  for (const Ratio& ratio : ratios) sorted.push_back(ratio.value);
  std::sort(sorted.begin(), sorted.end());
  const size_t hundredth = sorted.size() / 100;
  // Candidates go a little beyond what is seen, so that the maximum is inside.
  const double lowest = sorted[hundredth] / 1.2, highest = sorted[sorted.size() - 1 - hundredth] * 1.2;
  ScaleConsensus consensus(ScaleCandidates::between(lowest, highest));
  for (const Ratio& ratio : ratios) consensus.add_ratio(ratio.value, ratio.part);
  const auto estimate = consensus.estimate(estimator, kKnownDepthDeviation);
  if (!estimate) return std::nullopt;
  return widened_by_shape(
      *estimate, views, static_cast<double>(known) / static_cast<double>(views * static_cast<size_t>(parts)));
}

}  // namespace

std::optional<DepthScale> scale_from_sparse_points(const std::vector<DepthView>& views,
                                                   const std::vector<Eigen::Vector3d>& points_in_world) {
  std::vector<Ratio> ratios;
  const size_t step = 1 + points_in_world.size() / kMostPoints;
  for (size_t view = 0; view < views.size(); ++view) {
    const Camera& camera = views[view].camera;
    const Eigen::Isometry3d camera_from_world = camera.camera_from_world();
    for (size_t i = 0; i < points_in_world.size(); i += step) {
      const Eigen::Vector3d projected = camera.intrinsics * (camera_from_world * points_in_world[i]);
      if (!(projected.z() > 0)) continue;
      const double right = projected.x() / projected.z() / static_cast<double>(camera.width);
      const double down = projected.y() / projected.z() / static_cast<double>(camera.height);
      if (!(right >= 0 && right < 1 && down >= 0 && down < 1)) continue;
      const float depth = depth_at(views[view].depth, right, down);
      if (depth > 0) ratios.push_back({projected.z() / depth, part_of(view, right, down)});
    }
  }
  // Points stand for the part of the picture that they are in.
  std::set<std::pair<size_t, size_t>> parts;
  for (const Ratio& ratio : ratios) parts.emplace(ratio.part.view, ratio.part.block);
  return agreed(ratios, views.size(), parts.size(), kBlocksASide * kBlocksASide, "sparse_points");
}

std::optional<DepthScale> scale_from_measured_depth(const std::vector<DepthView>& views,
                                                    const std::vector<PlanarDepth>& measured,
                                                    const std::string& estimator) {
  std::vector<Ratio> ratios;
  size_t measured_views = 0;
  for (size_t view = 0; view < std::min(views.size(), measured.size()); ++view) {
    if (measured[view].values.empty()) continue;
    ++measured_views;
    for (int64_t y = 0; y < kSamplesASide; ++y) {
      for (int64_t x = 0; x < kSamplesASide; ++x) {
        const double right = (static_cast<double>(x) + 0.5) / static_cast<double>(kSamplesASide);
        const double down = (static_cast<double>(y) + 0.5) / static_cast<double>(kSamplesASide);
        const float known = depth_at(measured[view], right, down);
        const float depth = depth_at(views[view].depth, right, down);
        if (known > 0 && depth > 0) {
          ratios.push_back({static_cast<double>(known) / depth, part_of(view, right, down)});
        }
      }
    }
  }
  return agreed(ratios, measured_views, ratios.size(), kSamplesASide * kSamplesASide, estimator);
}

}  // namespace gld
