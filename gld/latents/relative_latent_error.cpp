#include "gld/latents/relative_latent_error.h"

#include <cmath>

namespace gld {

double relative_latent_error(const torch::Tensor& latents, const torch::Tensor& encoded) {
  const auto truth = encoded.to(torch::kFloat64);
  const auto apart = latents.to(torch::kFloat64) - truth;
  const auto spread = truth - truth.mean({0, 2, 3}, true);
  return std::sqrt(apart.square().sum().item<double>() / spread.square().sum().item<double>());
}

}  // namespace gld
