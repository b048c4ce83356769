#pragma once

#include "models/backbones/backbone.h"
#include "models/backbones/dinov2_backbone.h"
#include "models/layers/vit_block.h"

#include <cstdint>
#include <memory>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// The transformer that makes VGGT's patch tokens, patch_embed in model.yaml; patch_size, embed_dim, num_heads,
// mlp_ratio and pos_embed_grid are the model's.
struct VggtPatchEmbedOptions : OptionsGroup {
  Dinov2Sizes sizes;
  VggtPatchEmbedOptions() { sizes.depth = 24; }
  void visit(FieldVisitor& visitor) override;
};

// Defaults are VGGT-1B.
struct VggtBackboneOptions : BackboneArchitecture {
  int64_t patch_size = 14;  // pixels
  int64_t embed_dim = 1024;
  int64_t depth = 24;  // pairs of a frame and a global block
  int64_t num_heads = 16;
  double mlp_ratio = 4;
  int64_t num_register_tokens = 4;  // of a view, beside its camera token
  int64_t pos_embed_grid = 37;      // rows and columns of the stored position table
  double rope_frequency = 100;
  std::vector<int64_t> out_layers = {4, 11, 17, 23};  // pairs after which the levels are taken
  VggtPatchEmbedOptions patch_embed;

  void visit(FieldVisitor& visitor) override;
  void check() const override;

  std::string kind() const override { return "vggt"; }
  std::unique_ptr<BackboneArchitecture> copy() const override;
  std::shared_ptr<Backbone> make(const ParameterPlacement& placement) const override;
  std::string published_prefix() const override { return "aggregator."; }
  int64_t patch_side() const override { return patch_size; }
  int64_t levels() const override { return static_cast<int64_t>(out_layers.size()); }
  int64_t level_channels() const override { return 2 * embed_dim; }
  int64_t leading_tokens() const override { return 1 + num_register_tokens; }  // camera, registers
  int64_t leading_rows() const override { return 2; }
  // Blocks are counted as they run: block 2 i is the frame block of pair i, block 2 i + 1 its global block.
  int64_t blocks() const override { return 2 * depth; }
  bool attends_over_views(int64_t block) const override { return block % 2 == 1; }
  Cost encoding_cost(const LatentGrid& grid, int64_t last_level) const override;
  Cost propagation_cost(const LatentGrid& grid, int64_t level) const override;

  // Returns the sizes of the transformer in front.
  Dinov2Sizes patch_embed_sizes() const;
};

// The aggregator of VGGT (Wang et al. 2025): patch tokens of DINOv2 with registers, in front of them a learned camera
// token and register tokens, of which the first view has its own and all others share another; then pairs of a block
// within a view and a block over all views. Block norms have epsilon 1e-5, queries and keys are normalised and turn
// with the token's row and column + 1, in both kinds of blocks; leading tokens have position 0. A level is [output of
// the pair's frame block | output of its global block], raw, leading tokens first; the second half alone is the state
// that the next pair starts from. Decoders take levels raw: VGGT's heads have norms of their own.
//
// New views get their leading tokens from the first source view, as DA3's do, encoded beside itself: the first view's
// own tokens for the first view, and those that its copy got as a second view for all others. Only so do new views get
// tokens of the kind that views behind the first have; the published code leaves those of its last encoder call.
class VggtBackbone : public Backbone {
 public:
  VggtBackbone(const VggtBackboneOptions& options, const ParameterPlacement& placement);

  const VggtBackboneOptions& architecture() const override { return options_; }
  using Backbone::encode;
  std::vector<torch::Tensor> encode(const torch::Tensor& images, int64_t last_level,
                                    std::vector<AttentionTap>* taps) const override;
  torch::Tensor leading_for_propagation(const torch::Tensor& first_source, int64_t level) const override;
  std::vector<DecodableLevel> propagate(const PropagationStart& start) const override;
  torch::Tensor normalise_for_decoding(const torch::Tensor& patches) const override;

  // This follows DINOv2's scheme; layer scales are 1.
  void initialise(const torch::Generator& generator) override;

 private:
  // Runs pairs first_pair up to that of last_level, on (views, leading + patch tokens, embed_dim). Returns every level
  // that is reached.
  std::vector<torch::Tensor> run_pairs(torch::Tensor tokens, int64_t first_pair, int64_t last_level,
                                       const LatentGrid& grid, std::vector<AttentionTap>* taps) const;
  // (1, 2, n, embed_dim) -> (views, n, embed_dim)
  torch::Tensor of_views(const torch::Tensor& token, int64_t views) const;

  VggtBackboneOptions options_;
  std::shared_ptr<torch::nn::Module> patch_embed_;
  Dinov2Layers patch_layers_;
  std::vector<std::shared_ptr<VitBlock>> frame_blocks_, global_blocks_;
  torch::Tensor camera_token_;    // (1, 2, 1, embed_dim): first view, other views
  torch::Tensor register_token_;  // (1, 2, registers, embed_dim)
};

}  // namespace gld
