#include "train/objectives/feature_noise.h"

#include <cmath>

namespace gld {

std::vector<torch::Tensor> with_feature_noise(std::vector<torch::Tensor> levels, double deviation,
                                              torch::Generator& generator) {
  if (deviation == 0.0) return levels;
  const double strength = std::abs(torch::randn({1}, generator, torch::kFloat64).item<double>()) * deviation;
  for (auto& level : levels) {
    const auto noise = torch::randn(level.sizes(), generator, torch::kFloat32).to(level.device());
    level = level + strength * level.flatten(0, 1).std(0, /*unbiased=*/false) * noise;
  }
  return levels;
}

}  // namespace gld
