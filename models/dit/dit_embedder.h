#pragma once

#include "models/layers/layers.h"

#include <cstdint>
#include <memory>
#include <string>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// The two latents a DiT^DH embedder takes, normally as one tensor of twice the channels: what conditions it
// (source features; zero for target views) and the noisy latent, or the deeper level in its place. The embedding
// is their halves' sum, so that what does not change between evaluations is computed once.
enum class EmbedderHalf { kSource, kLatent };

struct DitEmbedderSizes {
  int64_t in_channels = 0;  // of one half
  int64_t width = 0;
  bool split = true;  // separate weights for source and target views
  int64_t special_tokens = 0;
};

// The token embedders of the condition encoder (part "s") or of the velocity decoder (part "x") under the names of
// the checkpoint: s_embedder_ref and s_embedder_tgt, or s_embedder; special_s_embedder and special_pos_embed_s.
// They are registered on the model itself.
class DitEmbedder {
 public:
  DitEmbedder(torch::nn::Module& model, const std::string& part, const DitEmbedderSizes& sizes,
              const ParameterPlacement& placement);

  // Embeds the patch tokens. source is (source views, tokens, channels) -> (views, tokens, width), bias included; the
  // source features of the target views are zero.
  torch::Tensor source_patches(const torch::Tensor& source, int64_t views) const;
  // Returns what features of target views that stand in the place of source features add to that, (target views,
  // tokens, channels) -> (target views, tokens, width).
  torch::Tensor target_features(const torch::Tensor& features) const;
  // (views, tokens, channels) -> (views, tokens, width), without the bias.
  torch::Tensor latent_patches(const torch::Tensor& latent, int64_t num_sources) const;
  // Embeds both halves in one product, as published.
  torch::Tensor patches(const torch::Tensor& source, const torch::Tensor& latent) const;

  // Does the same for the special tokens, learned positions included with the source half.
  torch::Tensor source_special(const torch::Tensor& source, int64_t views) const;
  torch::Tensor latent_special(const torch::Tensor& latent) const;
  torch::Tensor special(const torch::Tensor& source, const torch::Tensor& latent) const;

 private:
  torch::Tensor half(const torch::Tensor& weight, EmbedderHalf which) const;
  const PatchEmbed& target() const { return target_ ? *target_ : *source_; }

  DitEmbedderSizes sizes_;
  std::shared_ptr<PatchEmbed> source_;
  std::shared_ptr<PatchEmbed> target_;  // null where source views and target views share one
  std::shared_ptr<Linear> special_;
  torch::Tensor special_positions_;  // (1, special tokens, width)
};

}  // namespace gld
