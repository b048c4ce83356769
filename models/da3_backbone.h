#pragma once

#include "gld/camera.h"
#include "gld/options.h"
#include "models/layers.h"
#include "models/vit_block.h"

#include <cstdint>
#include <memory>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

enum class BackboneType { kDa3 };

// Defaults are DA3-Base. Small: embed_dim 384, 6 heads. Large: 1024, depth 24, 16 heads, out_layers 11, 15,
// 19, 23 and the three starts at 8. Giant: 1536, depth 40, 24 heads, out_layers 19, 27, 33, 39, the starts at
// 13, and ffn_layer swiglufused.
struct Da3BackboneOptions : OptionsGroup {
  BackboneType type = BackboneType::kDa3;
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

  void visit(FieldVisitor& visitor) override;
  void check() const override;
  int64_t levels() const { return static_cast<int64_t>(out_layers.size()); }
  int64_t level_channels() const { return 2 * embed_dim; }
  // Of an image; Error unless both sides are whole patches.
  LatentGrid grid_of(int64_t views, int64_t image_height, int64_t image_width) const;
};

// A level after the final normalisation, as decoders take it.
struct DecodableLevel {
  torch::Tensor class_tokens;  // (views, 2 embed_dim), raw
  torch::Tensor patches;       // (views, tokens, 2 embed_dim), second half through the final LayerNorm
};

struct PropagationStart {
  int64_t level = 1;
  torch::Tensor tokens;  // (views, 1 + tokens, 2 embed_dim) raw, class token first
  LatentGrid grid;
};

// The backbone of Depth Anything 3: DINOv2 blocks, the later of which alternate between attention within a
// view and over all views (DESIGN.md section 4, "Backbone"; depth_anything_3/model/dinov2 of the published
// code). Parameters have the published names behind kPrefix. A level is [output of the last local block |
// output of this block], raw, with the class token first. View 0 is the reference view; views are never
// reordered.
class Da3Backbone : public torch::nn::Module {
 public:
  static constexpr const char* kPrefix = "model.backbone.pretrained.";

  Da3Backbone(const Da3BackboneOptions& options, const ParameterPlacement& placement);

  const Da3BackboneOptions& options() const { return options_; }

  // images: (views, 3, height, width), ImageNet-normalised, sides whole patches. Returns levels
  // 0..last_level, each (views, 1 + tokens, 2 embed_dim); blocks behind last_level's are not run.
  // taps: what training wants of the attention of global blocks; others stay empty.
  std::vector<torch::Tensor> encode(const torch::Tensor& images, int64_t last_level,
                                    std::vector<AttentionTap>* taps = nullptr) const;

  // Runs the blocks behind start.level. Returns levels start.level (as given) to the last.
  std::vector<DecodableLevel> propagate(const PropagationStart& start) const;

  // (views, tokens, 2 embed_dim) raw -> the same with the second half through the final LayerNorm: what the
  // DPT head and the RGB decoder take.
  torch::Tensor normalise_for_decoding(const torch::Tensor& patches) const;

  // Splits a raw level into class tokens and decodable patches.
  DecodableLevel decodable(const torch::Tensor& level) const;

  // The position table for that grid: (1, 1 + tokens, embed_dim), class token first.
  torch::Tensor position_embedding(const LatentGrid& grid) const;

  // Random weights to train from (DINOv2's scheme; layer scales are 1).
  void initialise(const torch::Generator& generator);

 private:
  struct TokenState {
    torch::Tensor current;  // (views, 1 + tokens, embed_dim)
    torch::Tensor local;    // the same after the last local block
  };
  // Runs blocks first_block..; calls with every level that is reached, up to last_level.
  std::vector<torch::Tensor> run_blocks(TokenState state, int64_t first_block, int64_t last_level,
                                        const LatentGrid& grid, std::vector<AttentionTap>* taps) const;
  torch::Tensor with_camera_tokens(const torch::Tensor& tokens) const;
  void require_level(int64_t level) const;

  Da3BackboneOptions options_;
  std::shared_ptr<PatchEmbed> patch_embed_;
  std::vector<std::shared_ptr<VitBlock>> blocks_;
  std::shared_ptr<LayerNorm> norm_;
  torch::Tensor class_token_;     // (1, 1, embed_dim)
  torch::Tensor camera_token_;    // (1, 2, embed_dim): first view, other views; undefined without alternation
  torch::Tensor position_table_;  // (1, 1 + pos_embed_grid^2, embed_dim)
};

}  // namespace gld
