#pragma once

#include "models/layers/convolution.h"
#include "models/layers/layers.h"
#include "models/layers/operation_cost.h"
#include "models/layers/pixel_unet_options.h"

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// Convolutions of 3x3 pixels in pairs, with GELU after each, that halve the picture and double it again, each size seen
// beside the one that comes back from below. Parameters "encoder.I.first", "encoder.I.second", "decoder.I.first",
// "decoder.I.second", weight and bias each, of the module that it is made a part of.
class PixelUnet {
 public:
  // inputs is the number of channels of what it is shown.
  PixelUnet(torch::nn::Module& owner, const PixelUnetOptions& options, int64_t inputs,
            const ParameterPlacement& placement);

  // (pictures, inputs, height, width) -> (pictures, channels.front(), height, width), of any size.
  torch::Tensor operator()(const torch::Tensor& inputs) const;

 private:
  struct Pair {
    std::shared_ptr<Convolution> first, second;
    torch::Tensor operator()(const torch::Tensor& x) const;
  };
  struct Widths {
    int64_t inputs = 0, outputs = 0;
  };
  static Pair make_pair(torch::nn::Module& parent, const std::string& name, const Widths& widths,
                        const ParameterPlacement& placement);

  std::vector<Pair> encoder_, decoder_;
};

// Channels of what such a network is shown, and of what a last convolution of 3x3 pixels makes of it.
struct PixelUnetEnds {
  int64_t inputs = 0;
  int64_t outputs = 0;
};

// Returns the cost of one picture; nothing without the network.
Cost pixel_unet_cost(const PixelUnetOptions& options, const PixelUnetEnds& ends, int64_t height,
                     int64_t width);

}  // namespace gld
