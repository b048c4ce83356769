#pragma once

#include "gld/cameras/camera.h"
#include "models/backbones/backbone.h"

#include <cstdint>
#include <map>
#include <memory>
#include <vector>

#include <torch/types.h>

namespace gld {

// Levels as decoders take them.
struct CompletedLevels {
  // (views, patch tokens, C) by level; undefined where a level is neither generated nor propagated.
  std::vector<torch::Tensor> patches;
  // The last level's leading tokens, (views, leading tokens, C) raw; undefined where the last level is.
  torch::Tensor leading;
};

// What flow models generate and decoders get: the levels of a frozen backbone, be it a geometric foundation model,
// another network of image features or an autoencoder, whose one level is its latent. The latent of a level is what is
// generated of it, normalised with the level's statistics (gld/latents/level_statistics.h): its patch tokens, with the
// leading tokens in front of them where the model generates those too. A pipeline, a trainer, statistics, the planner
// and the forecast ask this; none holds a level's number.
//
// The boundary level goes through the remaining blocks, which gives the levels behind it (docs/DESIGN.md section 4,
// "Propagation"); backbones that propagate none have the deepest level as their boundary.
class LatentSpace {
 public:
  // boundary is the level that propagation starts from. Throws Error where the backbone has none of that number.
  LatentSpace(std::shared_ptr<const Backbone> backbone, int64_t boundary);

  int64_t levels() const { return backbone_->architecture().levels(); }
  int64_t leading_tokens() const { return backbone_->architecture().leading_tokens(); }
  // Returns the grid of an image; throws Error unless both sides are whole patches.
  LatentGrid grid_of(int64_t views, int64_t image_height, int64_t image_width) const;

  // images are (views, 3, height, width), RGB in [0, 1], encoded together. Returns levels 0..deepest, raw, (views,
  // leading + patch tokens, C).
  std::vector<torch::Tensor> encode(const torch::Tensor& images, int64_t deepest) const;

  // Returns what propagation puts in front of the views' patch tokens, (rows, leading tokens, C) raw
  // (Backbone::leading_for_propagation). source_images are as for encode; encoded holds their levels where these are
  // there already, which say it where a source view was encoded alone.
  torch::Tensor leading_for_propagation(const torch::Tensor& source_images,
                                        const std::vector<torch::Tensor>& encoded = {}) const;

  // Returns raw levels as decoders take them, (views, patch tokens, C).
  torch::Tensor decodable(const torch::Tensor& raw_level) const;
  // Returns all levels as decoders take them. generated holds raw levels by number, (views, patch tokens, C), or with
  // leading tokens in front; those behind the boundary level are propagated from it, with `leading` in front where it
  // has patch tokens only. A level that is neither is undefined.
  CompletedLevels complete(const std::map<int64_t, torch::Tensor>& generated, const torch::Tensor& leading,
                           const LatentGrid& grid) const;

 private:
  std::shared_ptr<const Backbone> backbone_;
  int64_t boundary_;
};

// Returns, of a raw level, what a generator with that many special tokens generates: none, or all leading tokens of the
// level.
torch::Tensor generated_tokens(const torch::Tensor& raw_level, int64_t leading_tokens,
                               int64_t special_tokens);

}  // namespace gld
