#pragma once

#include "gld/attention.h"

#include <torch/types.h>

namespace gld {

// Attention through the CPU kernels (gld/attention_kernel.h), for float32 tensors on the CPU and 1 to 256 channels a
// head; arguments and result as attention(), which checks them. Differentiable once: backward recomputes the
// probabilities from the stored log-sum-exp.
torch::Tensor fused_attention(const AttentionInputs& inputs);

// Whether it can take these arguments.
bool fused_attention_applies(const AttentionInputs& inputs);

}  // namespace gld
