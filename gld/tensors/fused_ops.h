#pragma once

#include <torch/types.h>

namespace gld {

// Element-wise passes that a composition of library operations makes several times over the same memory. In float32 on
// the CPU, while no gradients are recorded, each is one pass; otherwise the composition, of which LibTorch's own
// normalisation takes a part where there is one (has_library_rms_norm).

struct RmsNormInputs {
  torch::Tensor x;       // (..., channels)
  torch::Tensor weight;  // (channels), or undefined
  double epsilon = 0;
  // AdaLN's modulation, broadcast to x; both or none.
  torch::Tensor shift;
  torch::Tensor scale;
};

// Returns x / sqrt(mean(x^2) + epsilon) * weight * (1 + scale) + shift. It is exact to rounding for any finite x: rows
// whose squares would overflow or vanish are divided by a power of two first.
torch::Tensor rms_norm(const RmsNormInputs& inputs);

// Returns SiLU(a) * b with [a | b] = x: (..., 2 * width) -> (..., width) (Shazeer 2020).
torch::Tensor silu_gate(const torch::Tensor& x);

// Returns x + gate * update; gate is broadcast to x.
torch::Tensor gated_sum(const torch::Tensor& x, const torch::Tensor& gate, const torch::Tensor& update);

}  // namespace gld
