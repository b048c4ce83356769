#pragma once

#include <torch/types.h>

namespace gld {

// Reads features between the cells of a map that covers a picture evenly, bilinear, beyond the outermost cells' middles
// as there. features is (channels, rows, columns); places is (points, 2), x and y as shares of the picture's width and
// height. Returns (points, channels), float64 on the CPU.
torch::Tensor features_at(const torch::Tensor& features, const torch::Tensor& places);

}  // namespace gld
