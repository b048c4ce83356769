#include "gld/photogrammetry/window_sums.h"

#include <algorithm>
#include <cstddef>

namespace gld {

void window_sums(int64_t width, int64_t height, int64_t radius, std::vector<double>& values) {
  const auto line = [radius](double* first, int64_t count, int64_t stride, std::vector<double>& sums) {
    sums.assign(static_cast<size_t>(count + 1), 0);
    for (int64_t i = 0; i < count; ++i)
      sums[static_cast<size_t>(i + 1)] = sums[static_cast<size_t>(i)] + first[i * stride];
    for (int64_t i = 0; i < count; ++i) {
      first[i * stride] = sums[static_cast<size_t>(std::min(i + radius + 1, count))] -
                          sums[static_cast<size_t>(std::max<int64_t>(i - radius, 0))];
    }
  };
  std::vector<double> sums;
  for (int64_t y = 0; y < height; ++y) line(values.data() + y * width, width, 1, sums);
  for (int64_t x = 0; x < width; ++x) line(values.data() + x, height, width, sums);
}

}  // namespace gld
