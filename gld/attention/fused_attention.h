#pragma once

#include "gld/attention/attention.h"

#include <cstdint>

#include <torch/types.h>

namespace gld {

// Computes attention through the CPU kernels (gld/kernels/attention_kernel.h), for float32 tensors on the CPU and 1 to
// 256 channels a head; arguments and result are those of attention(), which checks them. It is differentiable once:
// backward recomputes the probabilities from the stored log-sum-exp.
torch::Tensor fused_attention(const AttentionInputs& inputs);

// Returns whether it can take these arguments, or any of this tensor's kind with heads of this size.
bool fused_attention_applies(const AttentionInputs& inputs);
bool fused_attention_applies(const torch::Tensor& like, int64_t head_dim);

// The same without a graph, for a caller that computes queries, keys and values again before the gradients
// (models/layers/activation_checkpoint.h).
struct AttentionResult {
  torch::Tensor output;       // as attention()
  torch::Tensor log_sum_exp;  // (batch, heads, queries)
};
AttentionResult fused_attention_result(const AttentionInputs& inputs);

// Gradients of a loss with respect to query, key and value, from that with respect to the output.
struct AttentionGradients {
  torch::Tensor query;
  torch::Tensor key;
  torch::Tensor value;
};
AttentionGradients fused_attention_gradients(const AttentionInputs& inputs, const AttentionResult& result,
                                             const torch::Tensor& output_gradient);

}  // namespace gld
