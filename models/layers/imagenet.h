#pragma once

#include <torch/types.h>

namespace gld {

// Normalises by the channel statistics that DINOv2-based backbones expect: (image - mean) / deviation with mean (0.485,
// 0.456, 0.406) and deviation (0.229, 0.224, 0.225). Images are (views, 3, height, width), RGB in [0, 1].
torch::Tensor imagenet_normalise(const torch::Tensor& images);
// Does the inverse; the result is not clamped to [0, 1].
torch::Tensor imagenet_denormalise(const torch::Tensor& images);

}  // namespace gld
