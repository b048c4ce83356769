#pragma once

#include "models/layers/convolution.h"
#include "models/layers/layers.h"
#include "models/layers/operation_cost.h"
#include "models/layers/residual_block.h"
#include "models/refiner/refiner_options.h"
#include "models/refiner/unet_attention.h"

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// The UNet of latent diffusion (Rombach et al. 2022) in the shape of Stable Diffusion 2.x, under the names of
// diffusers' UNet2DConditionModel, and beside them "prompt" (tokens, channels): what a text encoder made of the one
// text that there is, or what training made of it.
class DenoisingUnet : public torch::nn::Module {
 public:
  DenoisingUnet(const RefinerOptions& options, const ParameterPlacement& placement);

  const RefinerOptions& options() const { return options_; }

  // views are (scenes, views, latent channels, height, width), normalised, the degraded one first. Returns what the
  // network predicts of all of them, of the same shape.
  torch::Tensor forward(const torch::Tensor& views, int64_t timestep) const;

  // Draws random weights that predict 0.
  void initialise(const torch::Generator& generator);

 private:
  struct Stage {
    std::vector<std::shared_ptr<ResidualBlock>> layers;
    std::vector<std::shared_ptr<UnetAttention>> attentions;  // as many, or none
    std::shared_ptr<Convolution> resize;                     // null of the last
  };
  bool attends(size_t stage) const { return static_cast<int64_t>(stage) < options_.attending_stages; }
  std::shared_ptr<UnetAttention> make_attention(torch::nn::Module& parent, const std::string& name,
                                                size_t stage, const ParameterPlacement& placement) const;
  ResidualBlockSizes block_sizes(int64_t inputs, int64_t outputs) const;
  torch::Tensor time_embedding(int64_t timestep) const;
  // (scenes views, channels, height, width)
  torch::Tensor of_maps(const torch::Tensor& maps, int64_t timestep, const JoinedViews& joined) const;

  RefinerOptions options_;
  std::shared_ptr<Linear> time1_, time2_;
  std::shared_ptr<Convolution> input_, output_;
  std::vector<Stage> down_, up_;
  std::vector<std::shared_ptr<ResidualBlock>> middle_;
  std::shared_ptr<UnetAttention> middle_attention_;
  std::shared_ptr<GroupNorm> norm_;
  torch::Tensor prompt_;
};

// Makes one call, of a degraded view and its references: views are (scenes, 1 + references, channels, height, width),
// normalised. Returns the degraded ones repaired, (scenes, channels, height, width).
torch::Tensor refined_latents(const DenoisingUnet& unet, const torch::Tensor& views);

// Returns the cost of one call for so many views of latents of that size.
Cost refiner_cost(const RefinerOptions& options, int64_t views, int64_t height, int64_t width);

}  // namespace gld
