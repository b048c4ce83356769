#pragma once

#include <cstdint>
#include <vector>

#include <torch/types.h>

namespace gld {

// Returns a tensor's numbers in its order, float32, wherever it lies.
std::vector<float> numbers_of(const torch::Tensor& tensor);

// Turns (height, width, channels) values into (channels, height, width).
torch::Tensor planes_of(const std::vector<float>& values, int64_t channels, int64_t width, int64_t height);

// These turn (height, width, 3) into (3, height, width), and back.
torch::Tensor picture_of(const std::vector<float>& rgb, int64_t width, int64_t height);
std::vector<float> pixels_of(const torch::Tensor& picture);

}  // namespace gld
