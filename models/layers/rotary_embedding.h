#pragma once

#include <cstdint>

#include <torch/types.h>

namespace gld {

// 2-D rotary position embedding of backbones (DESIGN.md section 4, "Backbone"): the first half of each
// head's channels turns with the token's row, the second half with its column, each in split-half convention.
struct RotaryTables {
  torch::Tensor cosine;  // (tokens, 1, 2, head_dim / 4): row part, column part
  torch::Tensor sine;

  bool defined() const { return cosine.defined(); }
};

struct RotaryGrid {
  int64_t height = 0;    // patch tokens
  int64_t width = 0;     // patch tokens
  int64_t head_dim = 0;  // divisible by 4
  double frequency = 100;
  int64_t leading_tokens =
      1;  // class, camera and register tokens in front of the patches, at position (0, 0)
};

// Returns those for one view's tokens, leading tokens (position 0, 0) first: patch (row, column) has position (row + 1,
// column + 1).
RotaryTables local_rotary_tables(const RotaryGrid& grid, const torch::TensorOptions& options);
// Returns the same with position (1, 1) for every patch: attention over all views.
RotaryTables global_rotary_tables(const RotaryGrid& grid, const torch::TensorOptions& options);

// x: (views, tokens, heads, head_dim), tokens those of the tables -> the same shape, contiguous.
torch::Tensor apply_rotary(const torch::Tensor& x, const RotaryTables& tables);

}  // namespace gld
