#include "models/layers/time_embedding.h"

#include <cmath>

#include <torch/types.h>

namespace gld {

TimeEmbedding::TimeEmbedding(int64_t width, const ParameterPlacement& placement) {
  frequencies =
      register_parameter("W", torch::empty({kFrequencies}, placement.options()), /*requires_grad=*/false);
  auto mlp = register_module("mlp", std::make_shared<torch::nn::Module>());
  expansion_ = mlp->register_module(
      "0", std::make_shared<Linear>(LinearSizes{2 * kFrequencies, width, true, 1, LinearPacking::kNever},
                                    placement));
  projection_ = mlp->register_module(
      "2", std::make_shared<Linear>(LinearSizes{width, width, true, 1, LinearPacking::kNever}, placement));
}

torch::Tensor TimeEmbedding::forward(const std::vector<double>& times) const {
  const auto column = torch::tensor(times, torch::kFloat64).to(frequencies.device()).unsqueeze(1);
  const auto angles = column * frequencies.detach().to(torch::kFloat64) * (2.0 * M_PI);
  const auto waves = torch::cat({angles.sin(), angles.cos()}, 1).to(frequencies.scalar_type());
  return projection_->forward(torch::silu(expansion_->forward(waves)));
}

}  // namespace gld
