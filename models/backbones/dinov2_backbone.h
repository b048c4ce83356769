#pragma once

#include "models/backbones/backbone.h"
#include "models/layers/position_embedding.h"
#include "models/layers/vit_block.h"

#include <cstdint>
#include <memory>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

struct Dinov2Sizes {
  int64_t patch_size = 14;  // pixels
  int64_t embed_dim = 768;
  int64_t depth = 12;  // blocks
  int64_t num_heads = 12;
  double mlp_ratio = 4;
  FeedForward ffn_layer = FeedForward::kMlp;
  int64_t num_register_tokens = 4;
  int64_t pos_embed_grid = 37;  // rows and columns of the stored position table
  PositionResizing positions = {0.0, true};

  // Visits num_register_tokens, antialias and interpolate_offset; the rest a model around these layers has too.
  void visit_positions(FieldVisitor& visitor);
  void check() const;
  // Returns how many class and register tokens there are.
  int64_t leading_tokens() const { return 1 + num_register_tokens; }
  // Returns the cost of blocks [0, count) on the tokens of all views.
  Cost blocks_cost(const LatentGrid& grid, int64_t count) const;
};

// The layers of DINOv2 with registers (Oquab et al. 2023, Darcet et al. 2023), for the module that owns them: register
// tokens stand behind the class token and have no position; block and final norms have epsilon 1e-6. They are
// registered on the owner itself, under the names of the published files; mask_token is only kept.
class Dinov2Layers {
 public:
  Dinov2Layers(torch::nn::Module& owner, const Dinov2Sizes& sizes, const ParameterPlacement& placement);

  // images are (views, 3, height, width), RGB in [0, 1], sides whole patches. Returns what each of those blocks
  // (ascending) gives, through the final norm: (views, class + register + patch tokens, embed_dim).
  std::vector<torch::Tensor> forward(const torch::Tensor& images, const std::vector<int64_t>& blocks) const;

 private:
  Dinov2Sizes sizes_;
  std::shared_ptr<PatchEmbed> patch_embed_;
  std::vector<std::shared_ptr<VitBlock>> blocks_;
  std::shared_ptr<LayerNorm> norm_;
  torch::Tensor class_token_;      // (1, 1, embed_dim)
  torch::Tensor register_tokens_;  // (1, registers, embed_dim); undefined without them
  torch::Tensor position_table_;   // (1, 1 + pos_embed_grid^2, embed_dim)
};

// Defaults are DINOv2-Base with registers and its last layer, as RAE (Zheng et al. 2025) uses it. Small has embed_dim
// 384 and 6 heads, Large 1024, depth 24 and 16 heads. Without registers the published models have num_register_tokens
// 0, antialias false and interpolate_offset 0.1.
struct Dinov2Options : BackboneArchitecture {
  Dinov2Sizes sizes;
  std::vector<int64_t> out_layers;  // blocks after which the levels are taken; the last block when empty

  void visit(FieldVisitor& visitor) override;
  void check() const override;

  std::string kind() const override { return "dinov2"; }
  std::unique_ptr<BackboneArchitecture> copy() const override;
  std::shared_ptr<Backbone> make(const ParameterPlacement& placement) const override;
  std::string published_prefix() const override { return ""; }
  int64_t patch_side() const override { return sizes.patch_size; }
  int64_t levels() const override { return static_cast<int64_t>(level_blocks().size()); }
  int64_t level_channels() const override { return sizes.embed_dim; }
  int64_t leading_tokens() const override { return sizes.leading_tokens(); }
  int64_t blocks() const override { return sizes.depth; }
  bool attends_over_views(int64_t /*block*/) const override { return false; }
  bool propagates() const override { return false; }
  Cost encoding_cost(const LatentGrid& grid, int64_t last_level) const override;
  Cost propagation_cost(const LatentGrid& /*grid*/, int64_t /*level*/) const override { return {}; }

  std::vector<int64_t> level_blocks() const {
    return out_layers.empty() ? std::vector<int64_t>{sizes.depth - 1} : out_layers;
  }
};

// A level is what a block gives through the final norm, class and register tokens first; the norm's gain and shift
// vanish in the latent statistics. Views do not see each other, and nothing is propagated: every level that decoders
// take is generated.
class Dinov2Backbone : public Backbone {
 public:
  Dinov2Backbone(const Dinov2Options& options, const ParameterPlacement& placement);

  const Dinov2Options& architecture() const override { return options_; }
  using Backbone::encode;
  std::vector<torch::Tensor> encode(const torch::Tensor& images, int64_t last_level,
                                    std::vector<AttentionTap>* taps) const override;
  std::vector<DecodableLevel> propagate(const PropagationStart& start) const override;
  torch::Tensor normalise_for_decoding(const torch::Tensor& patches) const override;
  void initialise(const torch::Generator& generator) override;

 private:
  Dinov2Options options_;
  Dinov2Layers layers_;
};

}  // namespace gld
