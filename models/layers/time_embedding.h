#pragma once

#include "models/layers/layers.h"

#include <cstdint>
#include <memory>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// The embedding of the flow time: MLP([sin(2 pi W t) | cos(2 pi W t)]) with 256 fixed frequencies W that are part
// of the checkpoint ("W"; "mlp.0", "mlp.2" with a SiLU between them).
class TimeEmbedding : public torch::nn::Module {
 public:
  TimeEmbedding(int64_t width, const ParameterPlacement& placement);

  // Returns one row a time, (times, width). Angles are computed in double.
  torch::Tensor forward(const std::vector<double>& times) const;

  static constexpr int64_t kFrequencies = 256;
  torch::Tensor frequencies;  // W, (256), not trained

 private:
  std::shared_ptr<Linear> expansion_, projection_;
};

}  // namespace gld
