#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

namespace gld {

// The four cells of a grid about a place, and their weights in bilinear interpolation.
struct BilinearNeighbours {
  std::array<size_t, 4> cells;  // row by row; the first is the upper left one
  std::array<float, 4> weights;

  // x and y count from the first cell's middle; beyond the border the last cells count. width and height are at least
  // 1.
  BilinearNeighbours(int64_t width, int64_t height, double x, double y) {
    const double column = std::clamp(x, 0.0, static_cast<double>(width - 1));
    const double row = std::clamp(y, 0.0, static_cast<double>(height - 1));
    const auto left = static_cast<int64_t>(column), top = static_cast<int64_t>(row);
    const int64_t right = std::min(left + 1, width - 1), bottom = std::min(top + 1, height - 1);
    const auto to_right = static_cast<float>(column - static_cast<double>(left));
    const auto down = static_cast<float>(row - static_cast<double>(top));
    const auto cell = [width](int64_t at_row, int64_t at_column) {
      return static_cast<size_t>(at_row * width + at_column);
    };
    cells = {cell(top, left), cell(top, right), cell(bottom, left), cell(bottom, right)};
    weights = {(1 - down) * (1 - to_right), (1 - down) * to_right, down * (1 - to_right), down * to_right};
  }

  size_t nearest() const {
    return cells[static_cast<size_t>(std::max_element(weights.begin(), weights.end()) - weights.begin())];
  }
};

}  // namespace gld
