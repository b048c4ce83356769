#include "gld/latents/latent_divergence.h"

#include <torch/types.h>

namespace gld {
namespace {

double divergence(const torch::Tensor& mean, const torch::Tensor& variance) {
  // A channel that never varies has no logarithm.
  constexpr double kLeastVariance = 1e-6;
  const auto v = variance.to(torch::kFloat64).clamp_min(kLeastVariance);
  const auto m = mean.to(torch::kFloat64);
  return 0.5 * (v + m * m - 1 - v.log()).mean().item<double>();
}

}  // namespace

double latent_divergence(const LatentStatistics& of_scene, const LatentStatistics& statistics) {
  return divergence(statistics.normalise(of_scene.mean),
                    of_scene.variance / (statistics.variance + statistics.epsilon));
}

double latent_divergence(const torch::Tensor& features, const LatentStatistics& statistics) {
  const auto tokens = statistics.normalise(features).to(torch::kCPU, torch::kFloat64).flatten(0, -2);
  return divergence(tokens.mean(0), tokens.var(0, /*unbiased=*/false));
}

}  // namespace gld
