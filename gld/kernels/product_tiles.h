#pragma once

// Matrix products in tiles, compiled once per instruction set (see simd.h).

#include "gld/kernels/attention_tiles.h"
#include "gld/kernels/kernel_table.h"
#include "gld/kernels/simd.h"

namespace gld {
namespace {

void pack_rows_transposed(const PackedRows& rows) {
  const int64_t even = rows.depth / 4 * 4;
  for (int64_t r = 0; r < rows.width; r += 4) {
    for (int64_t k = 0; k < even; k += 4) {
      Quad q[4];
#pragma GCC unroll 4
      for (int i = 0; i < 4; ++i) {
        q[i] = r + i < rows.count ? load_quad(rows.x + (r + i) * rows.stride + k) : Quad{0, 0, 0, 0};
      }
      transpose_quads(q);
#pragma GCC unroll 4
      for (int i = 0; i < 4; ++i) store_quad(rows.packed + (k + i) * rows.width + r, q[i]);
    }
    for (int64_t k = even; k < rows.depth; ++k) {
      for (int64_t i = 0; i < 4; ++i) {
        rows.packed[k * rows.width + r + i] = r + i < rows.count ? rows.x[(r + i) * rows.stride + k] : 0;
      }
    }
  }
}

// Rows of y lie far apart, where the processor sees no stream to fetch ahead.
GLD_INLINE void prefetch_tile(const ProductTile& tile, const float* y) {
  for (int64_t m = 0; m < tile.rows; ++m) {
    for (int64_t n = 0; n < kTileLanes; n += 16) __builtin_prefetch(y + m * tile.y_stride + n, 1);
    __builtin_prefetch(y + m * tile.y_stride + kTileLanes - 1, 1);
  }
}

// Adds a sum over some inputs to the tile's columns; the first one sets them, with the bias.
GLD_INLINE void add_to_panel(const ProductTile& tile, int64_t first_column,
                             const Vector (&c)[kTileRows][kTileVectors], bool first) {
  float* y = tile.y + first_column;
  const float* bias = tile.bias == nullptr ? nullptr : tile.bias + first_column;
  const int64_t left = tile.columns - first_column;
  if (tile.rows == kTileRows && left >= kTileLanes) {
#pragma GCC unroll 8
    for (int m = 0; m < kTileRows; ++m) {
#pragma GCC unroll 8
      for (int n = 0; n < kTileVectors; ++n) {
        float* place = y + m * tile.y_stride + n * Simd::lanes;
        Vector sum = c[m][n];
        if (!first) sum = Simd::add(Simd::load(place), sum);
        if (first && bias != nullptr) sum = Simd::add(sum, Simd::load(bias + n * Simd::lanes));
        Simd::store(place, sum);
      }
    }
    return;
  }
  float sums[kTileRows * kTileLanes];
#pragma GCC unroll 8
  for (int m = 0; m < kTileRows; ++m) {
#pragma GCC unroll 8
    for (int n = 0; n < kTileVectors; ++n) Simd::store(sums + m * kTileLanes + n * Simd::lanes, c[m][n]);
  }
  const int64_t columns = left < kTileLanes ? left : kTileLanes;
  for (int64_t m = 0; m < tile.rows; ++m) {
    for (int64_t n = 0; n < columns; ++n) {
      float sum = sums[m * kTileLanes + n];
      if (!first) sum = y[m * tile.y_stride + n] + sum;
      if (first && bias != nullptr) sum += bias[n];
      y[m * tile.y_stride + n] = sum;
    }
  }
}

GLD_INLINE void product_panel(const ProductTile& tile, int64_t first_column) {
  prefetch_tile(tile, tile.y + first_column);
  const float* b = tile.b + first_column * tile.depth;
  for (int64_t k = 0; k < tile.depth; k += tile.summed) {
    Vector c[kTileRows][kTileVectors];
    clear_tile(c);
    const int64_t left = tile.depth - k, count = left < tile.summed ? left : tile.summed;
    multiply_tile<kTileRows, kTileVectors>(count, tile.a + k * kTileRows, kTileRows, 1, b + k * kTileLanes,
                                           kTileLanes, c);
    add_to_panel(tile, first_column, c, tile.first && k == 0);
  }
}

void product_tile(const ProductTile& tile) {
  for (int64_t column = 0; column < tile.columns; column += kTileLanes) product_panel(tile, column);
}

// So many vectors are summed up in one accumulator; longer sums lose digits.
constexpr int64_t kDotVectors = 256;

// Puts zeros behind the last input, which add nothing.
GLD_INLINE Vector load_first(const float* p, int64_t count) {
  float values[Simd::lanes] = {};
  for (int64_t i = 0; i < count; ++i) values[i] = p[i];
  return Simd::load(values);
}

template <int rows, int outputs, class Load>
GLD_INLINE void dot_step(const FewRowsTile& tile, const float* x, const float* weight, const Load& load,
                         Vector (&c)[rows][outputs]) {
  Vector operand[outputs];
#pragma GCC unroll 8
  for (int n = 0; n < outputs; ++n) operand[n] = load(weight + n * tile.weight_stride);
#pragma GCC unroll 8
  for (int m = 0; m < rows; ++m) {
    const Vector factor = load(x + m * tile.x_stride);
#pragma GCC unroll 8
    for (int n = 0; n < outputs; ++n) c[m][n] = Simd::accumulate(factor, operand[n], c[m][n]);
  }
}

// Every element of y is the same operations in the same order, whatever tile it lies in.
template <int rows, int outputs>
GLD_INLINE void dot_tile(const FewRowsTile& tile, int64_t first_row, int64_t first_output) {
  const float* x = tile.x + first_row * tile.x_stride;
  const float* weight = tile.weight + first_output * tile.weight_stride;
  float sums[rows][outputs] = {};
  for (int64_t begin = 0; begin < tile.inputs; begin += kDotVectors * Simd::lanes) {
    const int64_t left = tile.inputs - begin;
    const int64_t count = left < kDotVectors * Simd::lanes ? left : kDotVectors * Simd::lanes;
    Vector c[rows][outputs];
    clear_tile(c);
    int64_t k = begin;
    for (; k + Simd::lanes <= begin + count; k += Simd::lanes) {
      dot_step<rows, outputs>(
          tile, x + k, weight + k, [](const float* p) { return Simd::load(p); }, c);
    }
    if (k < begin + count) {
      const int64_t rest = begin + count - k;
      dot_step<rows, outputs>(
          tile, x + k, weight + k, [rest](const float* p) { return load_first(p, rest); }, c);
    }
#pragma GCC unroll 8
    for (int m = 0; m < rows; ++m) {
#pragma GCC unroll 8
      for (int n = 0; n < outputs; ++n) sums[m][n] += Simd::sum(c[m][n]);
    }
  }
  for (int m = 0; m < rows; ++m) {
    for (int n = 0; n < outputs; ++n) {
      const float bias = tile.bias == nullptr ? 0 : tile.bias[first_output + n];
      tile.y[(first_row + m) * tile.y_stride + first_output + n] = sums[m][n] + bias;
    }
  }
}

template <int outputs>
GLD_INLINE void dot_rows(const FewRowsTile& tile, int64_t first_output) {
  int64_t row = 0;
  for (; row + 4 <= tile.rows; row += 4) dot_tile<4, outputs>(tile, row, first_output);
  for (; row < tile.rows; ++row) dot_tile<1, outputs>(tile, row, first_output);
}

// 4 x 3 sums, 3 operands and a factor fill AVX2's 16 registers. The rows pass while three rows of weights stay in the
// first-level cache, so that all weights are read from memory once.
void few_rows_tile(const FewRowsTile& tile) {
  int64_t output = 0;
  for (; output + 3 <= tile.outputs; output += 3) dot_rows<3>(tile, output);
  for (; output < tile.outputs; ++output) dot_rows<1>(tile, output);
}

}  // namespace
}  // namespace gld
