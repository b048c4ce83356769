#pragma once

#include "gld/attention/attention.h"
#include "gld/camera_encoding/prope.h"
#include "models/layers/adaptive_norm.h"
#include "models/layers/layer_precision.h"
#include "models/layers/layers.h"
#include "models/layers/swiglu.h"

#include <cstdint>
#include <memory>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

struct DitBlockSizes {
  int64_t channels = 0;
  int64_t num_heads = 1;
  int64_t swiglu_width = 0;
  bool qk_norm = false;
};

// How the views of one pass (models/dit/dit_scene.h) attend to each other.
struct DitPassAttention {
  const PropeTables* prope = nullptr;
  AttentionTap* tap = nullptr;  // filled by forward(), where it is given
};

// What a block needs beside its input.
struct DitBlockContext {
  Modulation modulation;  // shift, scale, gate of attention, then of the feed-forward part
  // The input holds the views of one pass after the other, and each pass attends within itself.
  std::vector<DitPassAttention> passes;
};

// A block of DiT^DH: x + gate * attention(modulate(norm1(x))), then x + gate * swiglu(modulate(norm2(x))).
// Attention is over the tokens of all views, with PRoPE; norms are RMSNorm with epsilon 1e-6.
class DitBlock : public torch::nn::Module, public AttentionPrecisionLayer {
 public:
  DitBlock(const DitBlockSizes& sizes, const ParameterPlacement& placement);

  // x: (passes * views, tokens, channels) -> the same shape.
  torch::Tensor forward(const torch::Tensor& x, const DitBlockContext& context) const;
  int64_t head_dim() const { return sizes_.channels / sizes_.num_heads; }
  // Its two parts: what attends in each pass, and from the attention's outputs (passes, tokens of all views, heads,
  // head_dim) the rest.
  std::vector<AttentionInputs> attention_inputs(const torch::Tensor& x, const DitBlockContext& context) const;
  torch::Tensor finish(const torch::Tensor& x, const torch::Tensor& attended,
                       const DitBlockContext& context) const;
  // Makes of SiLU of one condition a row, (rows, channels), rows of a Modulation for this block.
  torch::Tensor modulation_rows(const torch::Tensor& activation) const;

 private:
  DitBlockSizes sizes_;
  std::shared_ptr<RmsNorm> norm1_, norm2_, query_norm_, key_norm_;
  std::shared_ptr<Linear> qkv_, projection_;
  std::shared_ptr<Swiglu> feed_forward_;
  std::shared_ptr<AdaptiveNorm> adaptive_norm_;
};

struct DitFinalLayerSizes {
  int64_t channels = 0;
  int64_t outputs = 0;
};

// The final layer in two steps, so that the branches of guidance can be combined between them.
class DitFinalLayer : public torch::nn::Module {
 public:
  DitFinalLayer(const DitFinalLayerSizes& sizes, const ParameterPlacement& placement);

  // modulate(norm(x)): (views, tokens, channels) -> the same shape.
  torch::Tensor features(const torch::Tensor& x, const Modulation& modulation) const;
  // (views, tokens, channels) -> (views, tokens, outputs).
  torch::Tensor project(const torch::Tensor& features) const;
  const torch::Tensor& bias() const { return linear_->bias; }  // of the projection

 private:
  std::shared_ptr<RmsNorm> norm_;
  std::shared_ptr<Linear> linear_;
  std::shared_ptr<AdaptiveNorm> adaptive_norm_;
};

}  // namespace gld
