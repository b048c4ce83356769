#include "models/layers/position_embedding.h"

#include <cmath>
#include <vector>

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

torch::Tensor resized_positions(const torch::Tensor& table, const LatentGrid& grid,
                                const PositionResizing& resizing) {
  const auto side = static_cast<int64_t>(std::llround(std::sqrt(static_cast<double>(table.size(1) - 1))));
  if (grid.height == side && grid.width == side) return table;
  const auto patches =
      table.slice(1, 1).view({1, side, side, table.size(2)}).permute({0, 3, 1, 2}).to(torch::kFloat32);
  const auto scale = [&](int64_t size) {
    return (static_cast<double>(size) + resizing.offset) / static_cast<double>(side);
  };
  const std::vector<int64_t> sizes = {grid.height, grid.width};
  const auto resized = resizing.antialias
                           ? torch::_upsample_bicubic2d_aa(patches, sizes, /*align_corners=*/false,
                                                           scale(grid.height), scale(grid.width))
                           : torch::upsample_bicubic2d(patches, sizes, /*align_corners=*/false,
                                                       scale(grid.height), scale(grid.width));
  return torch::cat({table.slice(1, 0, 1), resized.flatten(2).transpose(1, 2).to(table.scalar_type())}, 1);
}

}  // namespace gld
