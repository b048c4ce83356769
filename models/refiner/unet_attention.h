#pragma once

#include "models/layers/layer_precision.h"
#include "models/layers/layers.h"
#include "models/layers/residual_block.h"
#include "models/refiner/refiner_options.h"

#include <cstdint>
#include <memory>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// How the maps of a batch belong together: `views` behind each other are of one scene, the degraded one first.
struct JoinedViews {
  int64_t views = 1;
  ViewAttention attention = ViewAttention::kSelf;
};

// Returns the pairs of a query and a key that attention over pixels scores for a scene of so many views of so many
// pixels each: (views pixels)^2 of kGrid and kSelf, 2 (views - 1) pixels^2 of kCross.
double scored_pairs(int64_t views, double pixels, ViewAttention attention);

struct UnetAttentionSizes {
  int64_t channels = 0;
  int64_t heads = 1;
  int64_t groups = 32;
  int64_t prompt_channels = 0;
};

// The transformer block of Stable Diffusion's UNets under diffusers' names (Transformer2DModel with linear
// projections): x + proj_out(block(proj_in(norm(x)))), the block attention over pixels ("attn1"), over the prompt
// ("attn2") and a gated feed-forward layer ("ff"), each behind a layer norm and added.
class UnetAttention : public torch::nn::Module, public AttentionPrecisionLayer {
 public:
  UnetAttention(const UnetAttentionSizes& sizes, const ParameterPlacement& placement);
  // maps are (scenes views, channels, height, width); prompt is (tokens, prompt_channels).
  torch::Tensor forward(const torch::Tensor& maps, const torch::Tensor& prompt,
                        const JoinedViews& joined) const;

 private:
  struct Projections {
    std::shared_ptr<Linear> query, key, value, output;
  };
  Projections projections(torch::nn::Module& parent, const char* name, int64_t key_channels,
                          const ParameterPlacement& placement) const;
  // Tokens are (batch, tokens, channels) each.
  torch::Tensor attended(const Projections& by, const torch::Tensor& queries,
                         const torch::Tensor& keys) const;
  torch::Tensor over_pixels(const torch::Tensor& tokens, const JoinedViews& joined) const;

  UnetAttentionSizes sizes_;
  std::shared_ptr<GroupNorm> norm_;
  std::shared_ptr<Linear> proj_in_, proj_out_, expansion_, contraction_;
  std::shared_ptr<LayerNorm> norm1_, norm2_, norm3_;
  Projections pixels_, prompt_;
};

}  // namespace gld
