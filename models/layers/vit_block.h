#pragma once

#include "gld/attention/attention.h"
#include "models/layers/layer_precision.h"
#include "models/layers/layers.h"
#include "models/layers/rotary_embedding.h"

#include <cstdint>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// The feed-forward part of a DINOv2 block: fc2(GELU(fc1 x)), or w3(SiLU(a) * b) with [a | b] = w12 x. The
// published code knows the second under two names.
enum class FeedForward { kMlp, kSwiglu, kSwigluFused };

struct VitBlockSizes {
  int64_t embed_dim = 0;
  int64_t num_heads = 1;
  int64_t hidden_dim = 0;  // of the feed-forward part, as embed_dim * mlp_ratio; SwiGLU uses about 2/3 of it
  FeedForward feed_forward = FeedForward::kMlp;
  bool qk_norm = false;
  double norm_epsilon = 1e-6;  // of the block's two norms
};

// Which tokens see each other: those of one view, or those of all views.
enum class AttentionScope { kLocal, kGlobal };

// A DINOv2 block: x + ls1(attention(norm1(x))), then x + ls2(feed_forward(norm2(x))), with per-channel scales
// ls1, ls2 ("gamma"). Query and key norms have epsilon 1e-5.
class VitBlock : public torch::nn::Module, public AttentionPrecisionLayer {
 public:
  VitBlock(const VitBlockSizes& sizes, const ParameterPlacement& placement);

  // x: (views, tokens, embed_dim) -> the same shape. rotary turns queries and keys where it is defined.
  // tap, where it is given, gets what a global block's attention multiplies.
  torch::Tensor forward(const torch::Tensor& x, AttentionScope scope, const RotaryTables& rotary,
                        AttentionTap* tap = nullptr) const;

 private:
  torch::Tensor attend(const torch::Tensor& x, AttentionScope scope, const RotaryTables& rotary,
                       AttentionTap* tap) const;
  torch::Tensor feed_forward(const torch::Tensor& x) const;

  VitBlockSizes sizes_;
  std::shared_ptr<LayerNorm> norm1_, norm2_, query_norm_, key_norm_;
  std::shared_ptr<Linear> qkv_, projection_;
  std::shared_ptr<Linear> expansion_, contraction_;  // fc1, fc2 or w12, w3
  torch::Tensor attention_scale_, feed_forward_scale_;
};

}  // namespace gld
