#pragma once

#include "models/layers/layers.h"

#include <cstdint>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

struct ConvolutionSizes {
  int64_t in_channels = 0;
  int64_t out_channels = 0;
  int64_t kernel = 3;  // pixels; square
  int64_t stride = 1;
  int64_t padding = 1;  // zeros on each side
  bool bias = true;
};

// Returns the sizes of a convolution with an odd kernel and bias that keeps the size of its input.
ConvolutionSizes same_size_convolution(int64_t in_channels, int64_t out_channels, int64_t kernel);

// 2-D convolution; parameters "weight" (out, in, kernel, kernel) and "bias" (out).
class Convolution : public torch::nn::Module {
 public:
  Convolution(const ConvolutionSizes& sizes, const ParameterPlacement& placement);
  // (batch, in_channels, height, width) -> (batch, out_channels, height', width')
  torch::Tensor forward(const torch::Tensor& x) const;

  torch::Tensor weight;
  torch::Tensor bias;  // undefined without bias

 private:
  ConvolutionSizes sizes_;
};

// A transposed convolution whose kernel equals its stride, without padding: every pixel becomes a block of
// factor x factor pixels. Parameters "weight" (channels, channels, factor, factor) and "bias" (channels).
class BlockUpsampling : public torch::nn::Module {
 public:
  struct Sizes {
    int64_t channels = 0;
    int64_t factor = 2;
  };
  BlockUpsampling(const Sizes& sizes, const ParameterPlacement& placement);
  // (batch, channels, height, width) -> (batch, channels, factor * height, factor * width)
  torch::Tensor forward(const torch::Tensor& x) const;

  torch::Tensor weight;
  torch::Tensor bias;

 private:
  Sizes sizes_;
};

}  // namespace gld
