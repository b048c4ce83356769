#pragma once

#include "models/layers/layers.h"

#include <cstdint>
#include <memory>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

struct SwigluSizes {
  int64_t channels = 0;
  int64_t width = 0;  // between the two products
};

// Computes w3(SiLU(a) * b) with [a | b] = w12 x (Shazeer 2020).
class Swiglu : public torch::nn::Module {
 public:
  Swiglu(const SwigluSizes& sizes, const ParameterPlacement& placement);
  torch::Tensor forward(const torch::Tensor& x) const;  // (..., channels) -> the same shape

 private:
  std::shared_ptr<Linear> expansion_, contraction_;
};

}  // namespace gld
