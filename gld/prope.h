#pragma once

#include <torch/types.h>

#include "gld/camera.h"

namespace gld {

// The tables of PRoPE ("Cameras as Relative Positional Encoding"; DESIGN.md section 4) for one scene, computed once.
// Of each head's channels the first half is multiplied, in groups of 4, by a 4x4 matrix of the token's view; the third
// quarter rotates with the token's column and the last quarter with its row, split-half convention.
// Prefix (special) tokens in front of each view's patch tokens pass through unchanged.
struct PropeTables {
  LatentGrid grid;
  int64_t prefix_tokens = 0;           // per view
  torch::Tensor query_matrix;          // (views, 4, 4) P^T, float32
  torch::Tensor key_value_matrix;      // (views, 4, 4) P^-1
  torch::Tensor output_matrix;         // (views, 4, 4) P
  torch::Tensor column_cos;            // (grid width, head_dim / 8)
  torch::Tensor column_sin;
  torch::Tensor row_cos;               // (grid height, head_dim / 8)
  torch::Tensor row_sin;
};

}  // namespace gld
