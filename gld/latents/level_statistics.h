#pragma once

#include "gld/latents/latent_statistics.h"

#include <cstdint>
#include <optional>

#include <torch/types.h>

namespace gld {

// The statistics of one level's latent: of its patch tokens, and of the special tokens in front of them where those are
// generated too (all special tokens of a level share one mean and one variance, as in the published files for VGGT).
struct LevelStatistics {
  LatentStatistics patches;
  std::optional<LatentStatistics> special;
  int64_t special_tokens = 0;  // in front of the patch tokens of every view

  // tokens are (views, special + patch tokens, channels), and the result has the same shape. Throws Error where special
  // tokens have no statistics.
  torch::Tensor normalise(const torch::Tensor& tokens) const;
  torch::Tensor denormalise(const torch::Tensor& latent) const;  // the inverse
  LevelStatistics to(torch::Device device) const;
};

}  // namespace gld
