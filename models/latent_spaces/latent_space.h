#pragma once

#include "gld/cameras/camera.h"

#include <cstdint>
#include <map>
#include <vector>

#include <torch/types.h>

namespace gld {

// What source views say to the generation of the others.
struct SourceLatents {
  LatentGrid grid;  // of the source views
  // Raw features of levels 0, 1, ..., (sources, leading + patch tokens, C).
  std::vector<torch::Tensor> levels;
  // What propagation puts in front of the views' patch tokens, (rows, leading tokens, C) raw
  // (Backbone::carried_tokens).
  torch::Tensor carried;
};

// Levels as decoders take them.
struct CompletedLevels {
  // (views, patch tokens, C) by level; undefined where a level is neither generated nor propagated.
  std::vector<torch::Tensor> patches;
  // The last level's leading tokens, (views, leading tokens, C) raw; undefined where the last level is.
  torch::Tensor leading;
};

// What encode_sources has to make.
struct SourceEncoding {
  int64_t deepest = 0;  // level
  bool carried = true;  // whether views will be propagated
};

// What flow models generate and decoders get. The latent of a level is what is generated of it, normalised with the
// level's statistics (gld/latents/level_statistics.h): its patch tokens, with the leading tokens in front of them where
// the model generates those too. A pipeline, a trainer, statistics, the planner and the forecast ask this; none holds a
// level's number.
class LatentSpace {
 public:
  virtual ~LatentSpace() = default;

  virtual int64_t levels() const = 0;
  virtual int64_t leading_tokens() const = 0;
  // Of an image; Error unless both sides are whole patches.
  virtual LatentGrid grid_of(int64_t views, int64_t image_height, int64_t image_width) const = 0;

  // images: (views, 3, height, width), RGB in [0, 1], encoded together. Levels 0..deepest, raw, (views, leading + patch
  // tokens, C).
  virtual std::vector<torch::Tensor> encode(const torch::Tensor& images, int64_t deepest) const = 0;
  // The same of the source views alone, and what is carried over to new views.
  virtual SourceLatents encode_sources(const torch::Tensor& images, const SourceEncoding& wanted) const = 0;

  // Raw levels as decoders take them, (views, patch tokens, C).
  virtual torch::Tensor decodable(const torch::Tensor& raw_level) const = 0;
  // All levels as decoders take them. generated: raw levels by number, (views, patch tokens, C), or with leading tokens
  // in front; those behind the boundary level are propagated from it, with `carried` in front where it has patch tokens
  // only. A level that is neither is undefined.
  virtual CompletedLevels complete(const std::map<int64_t, torch::Tensor>& generated,
                                   const torch::Tensor& carried, const LatentGrid& grid) const = 0;
};

// Of a raw level, what a generator with that many special tokens generates: none, or all leading tokens of the level.
torch::Tensor generated_tokens(const torch::Tensor& raw_level, int64_t leading_tokens,
                               int64_t special_tokens);

}  // namespace gld
