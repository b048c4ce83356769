#pragma once

#include "gld/base/options.h"
#include "gld/cameras/camera.h"
#include "models/decoders/image_decoder.h"
#include "models/layers/layers.h"

#include <cstdint>
#include <memory>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// Defaults are the paper's decoder for DA3-Base. The released one has hidden_size 1152, 28 layers, 16 heads
// and intermediate_size 4096.
struct RgbDecoderOptions : OptionsGroup {
  int64_t in_channels = 6144;  // the four levels' channels together
  int64_t hidden_size = 768;
  int64_t num_layers = 12;
  int64_t num_heads = 12;
  int64_t intermediate_size = 3072;
  int64_t patch_size = 14;        // pixels
  int64_t base_image_size = 504;  // pixels; side of the image whose positions are stored
  double layer_norm_eps = 1e-12;
  int64_t refinement_channels =
      0;  // of convolutions over the drawn pixels (pixel_refinement.h); 0: none, as published
  int64_t refinement_layers = 4;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
  int64_t base_grid() const { return base_image_size / patch_size; }
  int64_t patch_values() const { return 3 * patch_size * patch_size; }
};

class PixelRefinement;
class RgbDecoderLayer;

// The ViT that turns the four levels into images (DESIGN.md section 4, "RGB decoder"; a ViT-MAE decoder with a class
// token of its own). Parameters have the published names behind kPrefix, "refinement.*" those of ours; the position
// table is a buffer, because it is never trained.
class RgbDecoder : public ImageDecoder {
 public:
  static constexpr const char* kPrefix = "decoder.";
  // Views attend within themselves, so they are decoded in groups; the widest activation of a group of this many tokens
  // is about 60 MB in the released decoder.
  static constexpr int64_t kTokensPerChunk = 4096;

  RgbDecoder(const RgbDecoderOptions& options, const ParameterPlacement& placement);

  const RgbDecoderOptions& options() const { return options_; }

  // features: (views, tokens, in_channels), the decodable levels 0..3 concatenated on channels ->
  // (views, tokens, 3 * patch_size^2): each patch's pixels, row by row, channels last, ImageNet-normalised.
  torch::Tensor logits(const torch::Tensor& features, const LatentGrid& grid) const;

  // Makes of logits images (views, 3, height, width), still ImageNet-normalised.
  torch::Tensor unpatchify(const torch::Tensor& logits, const LatentGrid& grid) const;

  // Decodes features to images (views, 3, height, width), RGB in about [0, 1], not clamped.
  torch::Tensor decode(const torch::Tensor& features, const LatentGrid& grid) const override;

  // Returns the position table for that grid: (1, 1 + tokens, hidden_size), class token first.
  torch::Tensor position_embedding(const LatentGrid& grid) const;

  // Returns the last layer's weight (3 * patch_size^2, hidden_size): the adaptive GAN weight is measured on it.
  const torch::Tensor& last_layer_weight() const { return prediction_->weight; }

  // Draws random weights and sine-cosine positions to train from.
  void initialise(const torch::Generator& generator);

 private:
  RgbDecoderOptions options_;
  std::shared_ptr<Linear> embedding_, prediction_;
  std::vector<std::shared_ptr<RgbDecoderLayer>> layers_;
  std::shared_ptr<LayerNorm> norm_;
  std::shared_ptr<PixelRefinement> refinement_;  // null without
  torch::Tensor class_token_;                    // (1, 1, hidden_size)
  torch::Tensor position_table_;                 // (1, 1 + base_grid^2, hidden_size), a buffer
};

// Pre-norm transformer layer with ViT-MAE's names: attention.attention.{query, key, value},
// attention.output.dense, intermediate.dense, output.dense, layernorm_before, layernorm_after.
class RgbDecoderLayer : public torch::nn::Module, public AttentionPrecisionLayer {
 public:
  RgbDecoderLayer(const RgbDecoderOptions& options, const ParameterPlacement& placement);
  torch::Tensor forward(const torch::Tensor& x) const;  // (views, tokens, hidden_size) -> the same shape

 private:
  torch::Tensor attend(const torch::Tensor& x) const;

  int64_t num_heads_;
  std::shared_ptr<Linear> query_, key_, value_, projection_, expansion_, contraction_;
  std::shared_ptr<LayerNorm> norm_before_, norm_after_;
};

}  // namespace gld
