#pragma once

#include "gld/attention.h"

#include <functional>

#include <torch/types.h>

namespace gld {

// Parts of a block whose intermediate tensors are not kept for the backward pass but computed again there: memory for
// time. The same values and gradients as computing them once. Only backward() is supported through them, not gradients
// of gradients; parameters used inside receive their gradients as usual.

// What a block computes from the tokens and the conditioning; the conditioning may be undefined.
using BlockFunction = std::function<torch::Tensor(const torch::Tensor& x, const torch::Tensor& conditioning)>;
torch::Tensor checkpointed(const BlockFunction& block, const torch::Tensor& x,
                           const torch::Tensor& conditioning = {});

// A block around attention: what attends, computed from tokens and conditioning, and what is made of the attention's
// output (batch, tokens, heads, head_dim).
struct AttentionBlock {
  std::function<AttentionInputs(const torch::Tensor& x, const torch::Tensor& conditioning)> inputs;
  std::function<torch::Tensor(const torch::Tensor& x, const torch::Tensor& attended,
                              const torch::Tensor& conditioning)>
      finish;
};
// finish(x, attention(inputs(x, conditioning)), conditioning), of which the output and the log-sum-exp of attention
// are kept, as they are dear to compute and small. Everything is computed again where the CPU kernels cannot
// take the inputs.
torch::Tensor checkpointed(const AttentionBlock& block, const torch::Tensor& x,
                           const torch::Tensor& conditioning);

}  // namespace gld
