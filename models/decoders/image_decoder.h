#pragma once

#include "gld/cameras/camera.h"

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// This makes images of the levels that decoders take: a trained RGB decoder, or an autoencoder's own half.
class ImageDecoder : public torch::nn::Module {
 public:
  // features: (views, tokens, channels), the decoded levels concatenated on channels -> images (views, 3, height,
  // width), RGB in about [0, 1], not clamped.
  virtual torch::Tensor decode(const torch::Tensor& features, const LatentGrid& grid) const = 0;
};

}  // namespace gld
