#pragma once

#include "models/layers/layers.h"

#include <cstdint>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

enum class ConvolutionPadding { kNone, kZeros, kCircular };

struct SpectralConvolutionSizes {
  int64_t in_channels = 0;
  int64_t out_channels = 0;
  std::vector<int64_t> kernel;  // one or two sides
  int64_t stride = 1;
  ConvolutionPadding padding = ConvolutionPadding::kNone;  // by (kernel - 1) / 2 on each side
};

// A 1-D or 2-D convolution whose weight is divided by its largest singular value (Miyato et al. 2018, algorithm
// 1), estimated by one power iteration a forward pass while training. Names as PyTorch's spectral_norm:
// parameters "weight_orig" and "bias", buffers "weight_u" and "weight_v".
class SpectralConvolution : public torch::nn::Module {
 public:
  SpectralConvolution(const SpectralConvolutionSizes& sizes, const ParameterPlacement& placement);
  // (batch, in_channels, length...) -> (batch, out_channels, length'...)
  torch::Tensor forward(const torch::Tensor& x);
  // Draws uniformly in +-1 / sqrt(fan in); the singular vectors start at random and are iterated to convergence.
  void initialise(const torch::Generator& generator);

 private:
  torch::Tensor normalised_weight();
  void iterate();

  SpectralConvolutionSizes sizes_;
  torch::Tensor weight_, bias_, left_, right_;
};

}  // namespace gld
