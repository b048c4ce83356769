#pragma once

#include <functional>

#include <torch/types.h>

namespace gld {

// What a block computes from the tokens and the conditioning; the conditioning may be undefined.
using BlockFunction = std::function<torch::Tensor(const torch::Tensor& x, const torch::Tensor& conditioning)>;

// block(x, conditioning) whose intermediate tensors are not kept for the backward pass but computed again there:
// memory for time. The same values and gradients as calling block. Only backward() is supported through it, not
// gradients of gradients; parameters used inside block receive their gradients as usual.
torch::Tensor checkpointed(const BlockFunction& block, const torch::Tensor& x,
                           const torch::Tensor& conditioning = {});

}  // namespace gld
