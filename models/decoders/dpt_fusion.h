#pragma once

#include "models/layers/convolution.h"
#include "models/layers/layers.h"

#include <cstdint>
#include <memory>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// The unit's result is added to this: x, or relu(x), which is what published code whose activations work in place adds
// it to.
enum class FusionResidual { kRaw, kRectified };

// Computes x + conv2(relu(conv1(relu(x)))), with 3x3 convolutions; parameters are "conv1" and "conv2".
class ResidualConvolution : public torch::nn::Module {
 public:
  ResidualConvolution(int64_t channels, FusionResidual residual, const ParameterPlacement& placement);
  torch::Tensor forward(const torch::Tensor& x) const;

 private:
  FusionResidual residual_;
  std::shared_ptr<Convolution> first_, second_;
};

// The first stage has only the running map; the others merge a lateral map.
enum class FusionInputs { kRunning, kRunningAndLateral };

// One fusion stage of a DPT decoder (Ranftl et al. 2021, "Vision Transformers for Dense Prediction", section
// 3): the running map plus the refined lateral map, refined, enlarged and mixed by a 1x1 convolution.
// Children "resConfUnit1" (lateral), "resConfUnit2" and "out_conv".
class FusionBlock : public torch::nn::Module {
 public:
  struct Sizes {
    int64_t channels = 0;
    FusionInputs inputs = FusionInputs::kRunningAndLateral;
    FusionResidual residual = FusionResidual::kRaw;
  };
  FusionBlock(const Sizes& sizes, const ParameterPlacement& placement);

  struct MapSize {
    int64_t height = 0;
    int64_t width = 0;
  };
  // running and lateral are (views, channels, height, width); lateral is undefined for FusionInputs::kRunning.
  // Returns (views, channels, size.height, size.width), enlarged bilinearly with aligned corners.
  torch::Tensor forward(const torch::Tensor& running, const torch::Tensor& lateral,
                        const MapSize& size) const;

 private:
  std::shared_ptr<ResidualConvolution> lateral_unit_, running_unit_;
  std::shared_ptr<Convolution> mix_;
};

}  // namespace gld
