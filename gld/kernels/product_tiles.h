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

}  // namespace
}  // namespace gld
