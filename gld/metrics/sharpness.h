#pragma once

#include <torch/types.h>

namespace gld {

// Mean squared difference of neighbouring pixels, along rows plus along columns, over channels, of each image clamped
// to [0, 1]. images: (views, channels, height, width), sides of at least 2 pixels. Returns (views), float64.
torch::Tensor gradient_energy(const torch::Tensor& images);

// The prediction's gradient energy over the true image's: 1 is as sharp, less is blurred, more is noisy or sharpened.
// Returns (views), float64; NaN where the true image has no edge at all.
torch::Tensor sharpness(const torch::Tensor& image, const torch::Tensor& prediction);

}  // namespace gld
