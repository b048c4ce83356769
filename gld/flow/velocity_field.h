#pragma once

#include <torch/types.h>

namespace gld {

// dx/dt = velocity(x, t) with t running from 1 (noise) to 0 (data); x_t = (1 - t) x_data + t noise.
class VelocityField {
 public:
  virtual ~VelocityField() = default;
  // state and result have any one shape and dtype; t is in [0, 1].
  virtual torch::Tensor velocity(const torch::Tensor& state, double t) = 0;
};

}  // namespace gld
