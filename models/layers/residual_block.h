#pragma once

#include "models/layers/convolution.h"
#include "models/layers/layers.h"

#include <cstdint>
#include <memory>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

struct GroupNormSizes {
  int64_t channels = 0;
  int64_t groups = 32;  // divide the channels
  double epsilon = 1e-6;
};

// Group normalisation of maps; parameters "weight" and "bias" (channels).
class GroupNorm : public torch::nn::Module {
 public:
  GroupNorm(const GroupNormSizes& sizes, const ParameterPlacement& placement);
  // (batch, channels, height, width)
  torch::Tensor forward(const torch::Tensor& x) const;

 private:
  GroupNormSizes sizes_;
  torch::Tensor weight_, bias_;
};

struct ResidualBlockSizes {
  int64_t inputs = 0;
  int64_t outputs = 0;
  int64_t groups = 32;
  double epsilon = 1e-6;      // of its norms
  int64_t time_channels = 0;  // of the embedding of a time that is added between its convolutions; 0: of none
};

// shortcut(x) + conv2(silu(norm2(conv1(silu(norm1(x))) + time_emb_proj(silu(time))))), the block of latent diffusion's
// autoencoders and UNets (Rombach et al. 2022) under diffusers' names. Where inputs and outputs are as many, the
// shortcut is x itself, else "conv_shortcut".
class ResidualBlock : public torch::nn::Module {
 public:
  ResidualBlock(const ResidualBlockSizes& sizes, const ParameterPlacement& placement);
  // x is (batch, inputs, height, width); time is (1 or batch, time_channels), undefined where the block has none.
  torch::Tensor forward(const torch::Tensor& x, const torch::Tensor& time = {}) const;

 private:
  std::shared_ptr<GroupNorm> norm1_, norm2_;
  std::shared_ptr<Convolution> conv1_, conv2_, shortcut_;
  std::shared_ptr<Linear> time_;
};

}  // namespace gld
