#include "models/decoders/single_view_unit.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gld {
namespace {

constexpr int64_t kDepthCells = 8;
// A feature that is the same in all scenes tells nothing, and nothing is to be divided by.
constexpr double kLeastDeviation = 1e-9;

}  // namespace

torch::Tensor look_of_view(const torch::Tensor& patches, const torch::Tensor& depth) {
  const auto cells = torch::adaptive_avg_pool2d(
      depth.to(torch::kCPU, torch::kFloat64).clamp_min(1e-12).log().unsqueeze(0), {kDepthCells, kDepthCells});
  return torch::cat({patches.to(torch::kCPU, torch::kFloat64).mean(0), cells.flatten()});
}

torch::Tensor single_view_features(const torch::Tensor& look, const Camera& camera) {
  const double focal = camera.intrinsics(0, 0) / static_cast<double>(camera.width);
  return torch::cat({look, torch::full({1}, std::log(focal), torch::kFloat64)});
}

UnitGuess guessed_unit(const SingleViewUnit& unit, const torch::Tensor& features) {
  const auto known = (features - unit.mean) / unit.deviation;
  const double guess = unit.offset + known.dot(unit.weights).item<double>();
  // What is no number is as usual.
  const double log_unit = std::isfinite(guess) ? std::clamp(guess, unit.least, unit.largest) : unit.offset;
  return {std::exp(log_unit), unit.log_deviation};
}

SingleViewUnit fit_single_view_unit(const torch::Tensor& features, const std::vector<double>& log_units) {
  const auto logs = torch::tensor(log_units, torch::kFloat64);
  SingleViewUnit unit;
  unit.mean = features.mean(0);
  unit.deviation = features.std(0, /*unbiased=*/false).clamp_min(kLeastDeviation);
  unit.offset = logs.mean().item<double>();
  unit.least = logs.min().item<double>();
  unit.largest = logs.max().item<double>();
  const auto known = (features - unit.mean) / unit.deviation, wanted = logs - unit.offset;
  const auto [u, s, vh] = torch::linalg_svd(known, /*full_matrices=*/false);
  const auto along = torch::mv(u.t(), wanted);
  unit.log_deviation = std::numeric_limits<double>::infinity();
  const double scenes = static_cast<double>(log_units.size());
  for (const double penalty : {1e-3, 1e-2, 1e-1, 1.0, 10.0}) {
    const auto shrunk = s.square() / (s.square() + penalty * scenes);
    // What a scene's own value has of its fit, the mean's share with it: the residual without it is larger by that.
    const auto own = torch::mv(u.square(), shrunk) + 1 / scenes;
    const auto left_out = (wanted - torch::mv(u, shrunk * along)) / (1 - own).clamp_min(kLeastDeviation);
    const double deviation = left_out.square().mean().sqrt().item<double>();
    if (!(deviation < unit.log_deviation)) continue;
    unit.log_deviation = deviation;
    unit.weights = torch::mv(vh.t(), s / (s.square() + penalty * scenes) * along);
  }
  return unit;
}

}  // namespace gld
