#pragma once

#include "gld/cameras/camera.h"

#include <torch/types.h>

namespace gld {

// Returns fixed sin-cos positions of a token grid, (grid height * grid width, channels), channels a multiple of 4: [sin
// | cos] of the column, then [sin | cos] of the row, with frequencies 10000^(-i / (channels / 4)). They are computed in
// double.
torch::Tensor sincos_positions(const LatentGrid& grid, int64_t channels, const torch::TensorOptions& options);

// How DINOv2 and what is built from it brings a learned table of positions to another grid, bicubically.
struct PositionResizing {
  // Published models differ: with an offset the sampling points are those of the scale (size + offset) / side, without
  // one those of size / side.
  double offset = 0.1;
  bool antialias = false;
};

// table: (1, 1 + side^2, channels), the class token's first -> (1, 1 + grid height * grid width, channels).
torch::Tensor resized_positions(const torch::Tensor& table, const LatentGrid& grid,
                                const PositionResizing& resizing);

}  // namespace gld
