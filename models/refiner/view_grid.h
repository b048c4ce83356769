#pragma once

#include <cstdint>

#include <torch/types.h>

namespace gld {

// How views are laid out as one picture: row by row, the degraded one top left.
struct ViewGrid {
  int64_t rows = 1;
  int64_t columns = 1;
};
// Returns ceil(views / 2) columns (Splatent's code). Throws Error for numbers of views that leave a cell empty: 3, 5, 7
// and so on.
ViewGrid view_grid(int64_t views);
// Returns the most views, at most so many, that leave no cell empty.
int64_t views_in_whole_grid(int64_t at_most);

// (scenes, views, channels, height, width) -> (scenes, channels, rows height, columns width)
torch::Tensor as_grid(const torch::Tensor& views);
// Does the inverse, of a picture of that grid.
torch::Tensor views_of_grid(const torch::Tensor& picture, const ViewGrid& grid);

}  // namespace gld
