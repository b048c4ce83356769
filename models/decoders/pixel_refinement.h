#pragma once

#include "models/layers/convolution.h"
#include "models/layers/layers.h"

#include <cstdint>
#include <memory>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// This draws what a linear layer cannot draw from one token at a time: the patches of a picture lie in a plane of as
// many dimensions as the token has channels, in which an edge at any place and angle is blurred, and they do not meet
// where they join. A few 3x3 convolutions with GELU between them look at the drawn pixels and add what is missing. It
// is ours; no published decoder has it. Parameters are "0.weight", "0.bias", "1.weight", ...
class PixelRefinement : public torch::nn::Module {
 public:
  struct Sizes {
    int64_t channels = 0;  // between the first and the last convolution
    int64_t layers = 0;    // at least 2
  };
  PixelRefinement(const Sizes& sizes, const ParameterPlacement& placement);

  // pixels: (views, 3, height, width) -> the same shape. Views are taken one at a time: that bounds memory, and each is
  // large enough.
  torch::Tensor forward(const torch::Tensor& pixels) const;

  // Draws random weights that add nothing yet.
  void initialise(const torch::Generator& generator);

 private:
  std::vector<std::shared_ptr<Convolution>> layers_;
};

}  // namespace gld
