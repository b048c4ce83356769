#pragma once

#include "gld/attention/attention.h"

#include <torch/types.h>

namespace gld {

// Attention as a composition of library operations, for any dtype and device, differentiable by the library. The
// arguments and the result are those of attention(), which checks them and should be called instead: these are what it
// falls back on and what benchmarks and tests compare with.

// Computes all logits at once, (batch * heads, queries, keys), which is what a model written with LibTorch's operations
// does.
torch::Tensor composed_attention(const AttentionInputs& inputs);

// Computes the same with at most 64 MB of logits at a time.
torch::Tensor row_blocked_attention(const AttentionInputs& inputs);

// Computes it by LibTorch's fused kernel (2.0 and newer, else it throws Error). In bfloat16 the encoded queries, keys
// and values are rounded, and the result is float32 again.
torch::Tensor library_attention(const AttentionInputs& inputs);

}  // namespace gld
