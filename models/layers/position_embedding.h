#pragma once

#include "gld/cameras/camera.h"

#include <torch/types.h>

namespace gld {

// Fixed sin-cos positions of a token grid, (grid height * grid width, channels), channels a multiple of 4:
// [sin | cos] of the column, then [sin | cos] of the row, with frequencies 10000^(-i / (channels / 4)). Computed in
// double.
torch::Tensor sincos_positions(const LatentGrid& grid, int64_t channels, const torch::TensorOptions& options);

}  // namespace gld
