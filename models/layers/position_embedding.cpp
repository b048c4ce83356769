#include "models/layers/position_embedding.h"

#include <cmath>

#include <torch/types.h>

namespace gld {

torch::Tensor sincos_positions(const LatentGrid& grid, int64_t channels,
                               const torch::TensorOptions& options) {
  const int64_t quarter = channels / 4;
  const auto exponents = torch::arange(quarter, torch::kFloat64) / static_cast<double>(quarter);
  const auto frequencies = torch::exp(exponents * -std::log(10000.0));
  const auto waves = [&](int64_t positions) {
    const auto angles = torch::arange(positions, torch::kFloat64).unsqueeze(1) * frequencies;
    return torch::cat({angles.sin(), angles.cos()}, 1);
  };
  const auto columns = waves(grid.width).unsqueeze(0).expand({grid.height, grid.width, 2 * quarter});
  const auto rows = waves(grid.height).unsqueeze(1).expand({grid.height, grid.width, 2 * quarter});
  return torch::cat({columns, rows}, 2).flatten(0, 1).to(options.requires_grad(false));
}

}  // namespace gld
