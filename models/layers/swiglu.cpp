#include "models/layers/swiglu.h"

#include "gld/tensors/fused_ops.h"

#include <torch/types.h>

namespace gld {

Swiglu::Swiglu(const SwigluSizes& sizes, const ParameterPlacement& placement) {
  expansion_ = register_module(
      "w12", std::make_shared<Linear>(LinearSizes{sizes.channels, 2 * sizes.width}, placement));
  contraction_ =
      register_module("w3", std::make_shared<Linear>(LinearSizes{sizes.width, sizes.channels}, placement));
}

torch::Tensor Swiglu::forward(const torch::Tensor& x) const {
  return contraction_->forward(silu_gate(expansion_->forward(x)));
}

}  // namespace gld
