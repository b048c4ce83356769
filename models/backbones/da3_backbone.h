#pragma once

#include "models/backbones/backbone.h"
#include "models/backbones/camera_encoder.h"
#include "models/layers/vit_block.h"

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// Defaults are DA3-Base. Small has embed_dim 384 and 6 heads. Large has 1024, depth 24, 16 heads, out_layers 11, 15,
// 19, 23 and the three starts at 8. Giant has 1536, depth 40, 24 heads, out_layers 19, 27, 33, 39, the starts at 13,
// and ffn_layer swiglufused.
struct Da3BackboneOptions : BackboneArchitecture {
  int64_t patch_size = 14;  // pixels
  int64_t embed_dim = 768;
  int64_t depth = 12;  // blocks
  int64_t num_heads = 12;
  double mlp_ratio = 4;
  FeedForward ffn_layer = FeedForward::kMlp;
  int64_t pos_embed_grid = 37;                      // rows and columns of the stored position table
  std::vector<int64_t> out_layers = {5, 7, 9, 11};  // blocks after which the levels are taken
  int64_t alternating_start = 4;                    // from here odd blocks attend over all views; -1: never
  int64_t qk_norm_start = 4;                        // -1: never
  int64_t rope_start = 4;                           // -1: never
  double rope_frequency = 100;
  int64_t camera_encoder_depth = 0;   // blocks of the encoder of known cameras; 0: none. Published: 4
  int64_t camera_encoder_heads = 16;  // its attention heads

  void visit(FieldVisitor& visitor) override;
  void check() const override;

  std::string kind() const override { return "da3"; }
  std::unique_ptr<BackboneArchitecture> copy() const override;
  std::shared_ptr<Backbone> make(const ParameterPlacement& placement) const override;
  std::string published_prefix() const override { return "model.backbone.pretrained."; }
  std::vector<std::pair<std::string, std::string>> published_elsewhere() const override {
    if (!takes_cameras()) return {};
    return {{"model.cam_enc.", "cam_enc."}};
  }
  int64_t patch_side() const override { return patch_size; }
  int64_t levels() const override { return static_cast<int64_t>(out_layers.size()); }
  int64_t level_channels() const override { return 2 * embed_dim; }
  int64_t leading_tokens() const override { return 1; }  // the class token
  int64_t blocks() const override { return depth; }
  bool attends_over_views(int64_t block) const override {
    return alternating_start >= 0 && block >= alternating_start && block % 2 == 1;
  }
  bool takes_cameras() const override { return camera_encoder_depth > 0; }
  Cost encoding_cost(const LatentGrid& grid, int64_t last_level) const override;
  Cost propagation_cost(const LatentGrid& grid, int64_t level) const override;
  // Returns the cost of blocks first_block up to, not including, last_block.
  Cost blocks_cost(const LatentGrid& grid, int64_t first_block, int64_t last_block) const;
};

// The backbone of Depth Anything 3: DINOv2 blocks, the later of which alternate between attention within a
// view and over all views (DESIGN.md section 4, "Backbone"; depth_anything_3/model/dinov2 of the published
// code). Parameters have the published names behind published_prefix(). A level is [output of the last local block |
// output of this block], raw, with the class token first. View 0 is the reference view; views are never
// reordered.
class Da3Backbone : public Backbone {
 public:
  Da3Backbone(const Da3BackboneOptions& options, const ParameterPlacement& placement);

  const Da3BackboneOptions& architecture() const override { return options_; }
  using Backbone::encode;
  std::vector<torch::Tensor> encode(const torch::Tensor& images, int64_t last_level,
                                    std::vector<AttentionTap>* taps) const override;
  using Backbone::encode_with_cameras;
  std::vector<torch::Tensor> encode_with_cameras(const torch::Tensor& images, int64_t last_level,
                                                 const std::vector<Camera>& cameras,
                                                 std::vector<AttentionTap>* taps) const override;
  // Returns the encoder's token of each camera, which takes the place of the learned camera token: (views, 1,
  // embed_dim). Throws Error without an encoder.
  torch::Tensor camera_tokens(const std::vector<Camera>& cameras) const;
  std::vector<DecodableLevel> propagate(const PropagationStart& start) const override;
  // The second half of the channels goes through the final LayerNorm.
  torch::Tensor normalise_for_decoding(const torch::Tensor& patches) const override;

  // Returns the position table for that grid: (1, 1 + tokens, embed_dim), class token first.
  torch::Tensor position_embedding(const LatentGrid& grid) const;

  // This follows DINOv2's scheme; layer scales are 1.
  void initialise(const torch::Generator& generator) override;

 private:
  struct TokenState {
    torch::Tensor current;  // (views, 1 + tokens, embed_dim)
    torch::Tensor local;    // the same after the last local block
    // (views, 1, embed_dim): what known cameras put in the place of the learned camera token; undefined for that one
    torch::Tensor camera_tokens;
  };
  // Runs blocks first_block.. and returns every level that is reached, up to last_level.
  std::vector<torch::Tensor> run_blocks(TokenState state, int64_t first_block, int64_t last_level,
                                        const LatentGrid& grid, std::vector<AttentionTap>* taps) const;
  std::vector<torch::Tensor> encode_with_tokens(const torch::Tensor& images, int64_t last_level,
                                                const torch::Tensor& camera_tokens,
                                                std::vector<AttentionTap>* taps) const;
  torch::Tensor with_camera_tokens(const TokenState& state) const;

  Da3BackboneOptions options_;
  std::shared_ptr<PatchEmbed> patch_embed_;
  std::vector<std::shared_ptr<VitBlock>> blocks_;
  std::shared_ptr<LayerNorm> norm_;
  std::shared_ptr<CameraEncoder> camera_encoder_;  // null without one
  torch::Tensor class_token_;                      // (1, 1, embed_dim)
  torch::Tensor camera_token_;    // (1, 2, embed_dim): first view, other views; undefined without alternation
  torch::Tensor position_table_;  // (1, 1 + pos_embed_grid^2, embed_dim)
};

}  // namespace gld
