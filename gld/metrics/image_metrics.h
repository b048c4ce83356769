#pragma once

#include <cstdint>

#include <torch/types.h>

namespace gld {

// Peak signal-to-noise ratio in dB of each image, both clamped to [0, 1]: -10 log10(mean squared difference).
// images: (views, channels, height, width). Returns (views), float64; infinity where the images are equal.
torch::Tensor psnr(const torch::Tensor& image, const torch::Tensor& prediction);

// Structural similarity (Wang et al. 2004) of each image with its prediction clamped to [0, 1]: Gaussian window
// of 11 pixels and deviation 1.5, sample covariance, data range 1, mean over the pixels whose window lies inside
// the image and over channels. images: (views, channels, height, width), sides of at least 11 pixels. Returns
// (views), float64.
torch::Tensor ssim(const torch::Tensor& image, const torch::Tensor& prediction);

}  // namespace gld
