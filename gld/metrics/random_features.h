#pragma once

#include <cstdint>
#include <vector>

#include <torch/types.h>

namespace gld {

constexpr int64_t kSmallestRandomFeatureSide = 8;  // of images, in pixels
constexpr int64_t kRandomFeatureMaps = 4;

// Returns the features themselves: a map a layer, (batch, channels, rows, columns), of length 1 along the channels, at
// the full resolution and at 1/2, 1/4 and 1/8 of it, sides rounded up. images is (batch, 3, height, width), clamped to
// [0, 1], with sides of at least 8 pixels.
std::vector<torch::Tensor> random_feature_maps(const torch::Tensor& images);

// Returns how unlike two batches of images look to a convolutional network of random weights, (batch), float64; it is 0
// for equal ones. Images are (batch, 3, height, width) in [0, 1], with sides of at least 8 pixels.
//
// The distance is that of LPIPS (Zhang et al. 2018, eq. 1) with all channels of a layer counted alike: squared
// differences of channel-normalised features, averaged over the image and over four layers of 3x3 convolutions with
// ReLU, at the full resolution and at 1/2, 1/4 and 1/8 of it. Nothing was ever trained on it or chosen by it, and its
// weights are the same everywhere (Philox), so that it stands in for LPIPS where its network is not at hand. It sees
// structure and misplaced edges, and nothing of objects; its numbers compare with each other only.
torch::Tensor random_feature_distance(const torch::Tensor& images, const torch::Tensor& others);

}  // namespace gld
