#include "models/layers/rotary_embedding.h"

#include "gld/base/error.h"

#include <string>

namespace gld {
namespace {

// positions are (tokens, 2) of row and column, float32.
RotaryTables tables_of(const torch::Tensor& positions, const RotaryGrid& grid,
                       const torch::TensorOptions& options) {
  if (grid.head_dim <= 0 || grid.head_dim % 4 != 0) {
    fail({"rotary position embedding", "a head size divisible by 4", std::to_string(grid.head_dim),
          "change num_heads or embed_dim, or set rope_start: -1"});
  }
  const int64_t axis_channels = grid.head_dim / 2;
  const auto exponents =
      torch::arange(0, axis_channels, 2, torch::kFloat32) / static_cast<double>(axis_channels);
  const auto inverse_frequencies = torch::pow(grid.frequency, exponents).reciprocal();
  const auto angles = positions.unsqueeze(-1) * inverse_frequencies;  // (tokens, 2, head_dim / 4)
  const auto place = [&](const torch::Tensor& table) {
    return table.unsqueeze(1).to(options.device(), torch::typeMetaToScalarType(options.dtype()));
  };
  return {place(angles.cos()), place(angles.sin())};
}

}  // namespace

RotaryTables local_rotary_tables(const RotaryGrid& grid, const torch::TensorOptions& options) {
  const auto rows = torch::arange(1, grid.height + 1, torch::kFloat32).repeat_interleave(grid.width);
  const auto columns = torch::arange(1, grid.width + 1, torch::kFloat32).repeat({grid.height});
  const auto patches = torch::stack({rows, columns}, 1);
  return tables_of(torch::cat({torch::zeros({grid.leading_tokens, 2}), patches}), grid, options);
}

RotaryTables global_rotary_tables(const RotaryGrid& grid, const torch::TensorOptions& options) {
  const auto patches = torch::ones({grid.height * grid.width, 2});
  return tables_of(torch::cat({torch::zeros({grid.leading_tokens, 2}), patches}), grid, options);
}

torch::Tensor apply_rotary(const torch::Tensor& x, const RotaryTables& tables) {
  const int64_t views = x.size(0), tokens = x.size(1), heads = x.size(2), head_dim = x.size(3);
  if (tokens != tables.cosine.size(0) || head_dim != 4 * tables.cosine.size(3)) {
    fail({"rotary position embedding",
          std::to_string(tables.cosine.size(0)) + " tokens of " + std::to_string(4 * tables.cosine.size(3)) +
              " channels",
          c10::str(x.sizes()), "give the token grid that the features were computed on"});
  }
  // The axes are view, token, head, {row, column}, {first, second half}, channel.
  const auto parts = x.reshape({views, tokens, heads, 2, 2, head_dim / 4});
  const auto first = parts.select(4, 0), second = parts.select(4, 1);
  return torch::stack(
             {first * tables.cosine - second * tables.sine, second * tables.cosine + first * tables.sine}, 4)
      .view({views, tokens, heads, head_dim});
}

}  // namespace gld
