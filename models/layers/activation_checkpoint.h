#pragma once

#include "gld/attention/attention.h"

#include <cstdint>
#include <functional>
#include <vector>

#include <torch/types.h>

namespace gld {

// Parts of a model whose intermediate tensors are not kept for the backward pass but computed again there: memory for
// time. The same values and gradients as computing them once, up to the order of summation. Only backward() is
// supported through them, not gradients of gradients; parameters used inside receive their gradients as usual.

// What a part computes from the tokens and the conditioning; the conditioning may be undefined.
using PartFunction = std::function<torch::Tensor(const torch::Tensor& x, const torch::Tensor& conditioning)>;
torch::Tensor checkpointed(const PartFunction& part, const torch::Tensor& x,
                           const torch::Tensor& conditioning = {});

constexpr int64_t kTokensRecomputedAtOnce = 1024;

// Does the same for a part that treats the views (dimension 0 of x) alone: gradients are computed for about
// kTokensRecomputedAtOnce tokens at a time, so that what the part makes on the way is never there for all of them.
// conditioning is of each view, or, where its first dimension is 1, of all.
torch::Tensor checkpointed_by_views(const PartFunction& part, const torch::Tensor& x,
                                    const torch::Tensor& conditioning = {});

// A block around attention: what attends, computed from tokens and conditioning, in one or several parts of the tokens
// that attend each within itself; and what is made of the attention's output, which is handed over in the shape of x,
// the parts one after the other. finish treats views alone, as in checkpointed_by_views.
struct AttentionBlock {
  int64_t head_dim = 0;
  std::function<std::vector<AttentionInputs>(const torch::Tensor& x, const torch::Tensor& conditioning)>
      inputs;
  std::function<torch::Tensor(const torch::Tensor& x, const torch::Tensor& attended,
                              const torch::Tensor& conditioning)>
      finish;
  torch::Tensor conditioning;  // may be undefined
};
// Runs blocks one after the other, each x = finish(x, attention(inputs(x, conditioning)), conditioning). Kept are the
// input of the first, and the output and the log-sum-exp of every attention, as they are dear to compute and small.
// Where the CPU kernels cannot take the inputs, every block's input is kept and all else is computed again. There is at
// least one block.
torch::Tensor checkpointed(const std::vector<AttentionBlock>& blocks, const torch::Tensor& x);

}  // namespace gld
