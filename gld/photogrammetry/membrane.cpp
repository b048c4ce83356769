#include "gld/photogrammetry/membrane.h"

#include <algorithm>
#include <cstddef>

namespace gld {
namespace {

// A level of the pyramid: sums of weight times value, and of weights, at most 1 each.
struct Level {
  int64_t width = 0;
  int64_t height = 0;
  std::vector<float> sums;     // (height, width, channels)
  std::vector<float> weights;  // (height, width)

  size_t cell(int64_t row, int64_t column) const { return static_cast<size_t>(row * width + column); }
};

// Every cell takes the 2x2 below it. Their weights add up to at most 1, so that a well-known cell is not outvoted by
// its size alone.
Level halved(const Level& fine, size_t channels) {
  Level coarse;
  coarse.width = (fine.width + 1) / 2;
  coarse.height = (fine.height + 1) / 2;
  coarse.sums.assign(static_cast<size_t>(coarse.width * coarse.height) * channels, 0.0F);
  coarse.weights.assign(static_cast<size_t>(coarse.width * coarse.height), 0.0F);
  for (int64_t row = 0; row < fine.height; ++row) {
    for (int64_t column = 0; column < fine.width; ++column) {
      const size_t from = fine.cell(row, column), to = coarse.cell(row / 2, column / 2);
      coarse.weights[to] += fine.weights[from];
      for (size_t c = 0; c < channels; ++c) coarse.sums[to * channels + c] += fine.sums[from * channels + c];
    }
  }
  for (size_t cell = 0; cell < coarse.weights.size(); ++cell) {
    if (coarse.weights[cell] <= 1) continue;
    const float factor = 1 / coarse.weights[cell];
    coarse.weights[cell] = 1;
    for (size_t c = 0; c < channels; ++c) coarse.sums[cell * channels + c] *= factor;
  }
  return coarse;
}

// Two neighbours along one side of a halved grid and their weights for the middle of a fine cell.
struct HalvedNeighbours {
  int64_t near, far;
  HalvedNeighbours(int64_t fine, int64_t count)
      : near(fine / 2), far(std::clamp<int64_t>(fine % 2 == 0 ? fine / 2 - 1 : fine / 2 + 1, 0, count - 1)) {}
  static constexpr float kNear = 0.75F, kFar = 0.25F;
};

// What a level does not know itself it takes from the coarser surface, which has no gaps.
void pushed(const std::vector<float>& surface, const Level& coarse, Level& fine, size_t channels) {
  for (int64_t row = 0; row < fine.height; ++row) {
    const HalvedNeighbours rows(row, coarse.height);
    for (int64_t column = 0; column < fine.width; ++column) {
      const HalvedNeighbours columns(column, coarse.width);
      const size_t here = fine.cell(row, column);
      const float missing = 1 - std::min(fine.weights[here], 1.0F);
      if (missing <= 0) continue;
      const size_t nn = coarse.cell(rows.near, columns.near), nf = coarse.cell(rows.near, columns.far),
                   fn = coarse.cell(rows.far, columns.near), ff = coarse.cell(rows.far, columns.far);
      for (size_t c = 0; c < channels; ++c) {
        using N = HalvedNeighbours;
        const float coarser =
            N::kNear * (N::kNear * surface[nn * channels + c] + N::kFar * surface[nf * channels + c]) +
            N::kFar * (N::kNear * surface[fn * channels + c] + N::kFar * surface[ff * channels + c]);
        fine.sums[here * channels + c] += missing * coarser;
      }
    }
  }
}

}  // namespace

std::vector<float> membrane(int64_t width, int64_t height, int64_t channels, const std::vector<float>& values,
                            const std::vector<float>& weights) {
  const auto depth = static_cast<size_t>(channels);
  std::vector<Level> levels(1);
  levels[0].width = width;
  levels[0].height = height;
  levels[0].weights = weights;
  levels[0].sums = values;
  for (size_t cell = 0; cell < weights.size(); ++cell) {
    levels[0].weights[cell] = std::min(weights[cell], 1.0F);
    for (size_t c = 0; c < depth; ++c) {
      float& sum = levels[0].sums[cell * depth + c];
      sum = levels[0].weights[cell] > 0 ? levels[0].weights[cell] * sum : 0.0F;
    }
  }
  while (levels.back().width > 1 || levels.back().height > 1) levels.push_back(halved(levels.back(), depth));
  Level& top = levels.back();
  for (size_t c = 0; c < depth; ++c) top.sums[c] = top.weights[0] > 0 ? top.sums[c] / top.weights[0] : 0.0F;
  for (size_t level = levels.size() - 1; level > 0; --level) {
    pushed(levels[level].sums, levels[level], levels[level - 1], depth);
  }
  return std::move(levels[0].sums);
}

}  // namespace gld
