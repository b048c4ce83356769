#include "models/refiner/view_grid.h"

#include "gld/base/error.h"

#include <algorithm>

#include <fmt/format.h>

namespace gld {

ViewGrid view_grid(int64_t views) {
  ViewGrid grid;
  grid.columns = std::max<int64_t>(1, (views + 1) / 2);
  grid.rows = std::max<int64_t>(1, (views + grid.columns - 1) / grid.columns);
  if (views < 1 || grid.rows * grid.columns != views) {
    fail({"references", "0 or an odd number, so that with the degraded view no cell of the grid is empty",
          fmt::format("{}", views - 1), "take one more or one less, or attention self or cross"});
  }
  return grid;
}

int64_t views_in_whole_grid(int64_t at_most) { return at_most <= 2 ? at_most : at_most / 2 * 2; }

torch::Tensor as_grid(const torch::Tensor& views) {
  const ViewGrid grid = view_grid(views.size(1));
  const int64_t channels = views.size(2), height = views.size(3), width = views.size(4);
  return views.reshape({views.size(0), grid.rows, grid.columns, channels, height, width})
      .permute({0, 3, 1, 4, 2, 5})
      .reshape({views.size(0), channels, grid.rows * height, grid.columns * width});
}

torch::Tensor views_of_grid(const torch::Tensor& picture, const ViewGrid& grid) {
  const int64_t channels = picture.size(1), height = picture.size(2) / grid.rows,
                width = picture.size(3) / grid.columns;
  return picture.reshape({picture.size(0), channels, grid.rows, height, grid.columns, width})
      .permute({0, 2, 4, 1, 3, 5})
      .reshape({picture.size(0), grid.rows * grid.columns, channels, height, width});
}

}  // namespace gld
