#include "models/swiglu.h"

#include <torch/types.h>

namespace gld {

Swiglu::Swiglu(const SwigluSizes& sizes, const ParameterPlacement& placement) {
  expansion_ = register_module(
      "w12", std::make_shared<Linear>(LinearSizes{sizes.channels, 2 * sizes.width}, placement));
  contraction_ =
      register_module("w3", std::make_shared<Linear>(LinearSizes{sizes.width, sizes.channels}, placement));
}

torch::Tensor Swiglu::forward(const torch::Tensor& x) const {
  const auto halves = expansion_->forward(x).chunk(2, -1);
  return contraction_->forward(torch::silu(halves[0]) * halves[1]);
}

}  // namespace gld
