#pragma once

#include "gld/camera_encoding/prope.h"
#include "gld/machine/matrix_unit.h"

#include <cstdint>
#include <optional>

#include <torch/types.h>

namespace gld {

// Softmax attention, softmax(scale * q k^T) v, never materialising all logits at once.
struct AttentionInputs {
  // Each is (batch, tokens, heads, head_dim), with any strides and a contiguous last dimension, so that slices of one
  // joint qkv projection need no copy. key and value may have another token count than query.
  torch::Tensor query;
  torch::Tensor key;
  torch::Tensor value;
  // This camera encoding (PRoPE) is applied to query, key, value and the output; there is none when it is null. The
  // batch is then 1 scene and the tokens are views x (prefix + grid).
  const PropeTables* prope = nullptr;
  // kFloat32, or kBFloat16 for the products of float32 tensors, of their gradients too; softmax and sums are float32
  // then too. By kernels of ours on the CPU; elsewhere by LibTorch's fused attention, and without it in float32.
  ComputePrecision precision = ComputePrecision::kFloat32;
};

// What one block's attention multiplies with each other, for a loss on it (train/objectives/correspondence.h): queries
// and keys after normalisation and camera or rotary encoding, (1, tokens of all views, heads, head_dim), with their
// gradients.
struct AttentionTap {
  int64_t block = 0;  // counted over the whole model
  torch::Tensor query;
  torch::Tensor key;
};

// Returns (batch, tokens, heads, head_dim), contiguous. scale is 1/sqrt(head_dim). A row with no key is zero. The
// result is differentiable.
torch::Tensor attention(const AttentionInputs& inputs);

}  // namespace gld
