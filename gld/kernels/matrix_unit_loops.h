#pragma once

// Products and conversions on any matrix unit, and the table of its kernels, compiled once per unit (unit_simd.h). Unit
// is DotUnit or a TileUnit.

#include "gld/kernels/matrix_unit_kernels.h"
#include "gld/kernels/unit_attention_loops.h"
#include "gld/kernels/unit_simd.h"

namespace gld {
namespace {

// Rows of y lie far apart, where the processor sees no stream to fetch ahead.
template <class Unit>
GLD_INLINE void prefetch_sums(const UnitProductTile& tile, const float* y) {
  for (int64_t m = 0; m < tile.rows; ++m) {
    for (int64_t n = 0; n < Unit::lanes; n += 16) __builtin_prefetch(y + m * tile.y_stride + n, 1);
  }
}

template <class Unit, OperandKind kind>
GLD_INLINE void product_of_panel(const UnitProductTile& tile, int64_t column) {
  const uint32_t* b = tile.b + column * tile.words;
  float* y = tile.y + column;
  prefetch_sums<Unit>(tile, y);
  const bool first = tile.first;
  const float* bias = first && tile.bias != nullptr ? tile.bias + column : nullptr;
  const auto scaled = [&](int m, int n, Vector sums) __attribute__((always_inline)) {
    if constexpr (kind == OperandKind::kBFloat16) {
      return sums;
    } else {
      const int64_t place = column + n * Simd::lanes;
      const Vector whole = UnitSimd::without_zero(sums, tile.row_zeros[m], tile.column_sums + place);
      return Simd::multiply(Simd::multiply(whole, Simd::broadcast(tile.row_scales[m])),
                            Simd::load(tile.column_scales + place));
    }
  };
  if (tile.rows == Unit::rows && tile.columns - column >= Unit::lanes) {
    Unit::template multiply<kind>(
        tile.words, tile.a, tile.a_stride, b,
        Unit::lanes, [&](int m, int n, Vector sums) __attribute__((always_inline)) {
          float* place = y + m * tile.y_stride + n * Simd::lanes;
          Vector sum = scaled(m, n, sums);
          if (!first) sum = Simd::add(Simd::load(place), sum);
          if (bias != nullptr) sum = Simd::add(sum, Simd::load(bias + n * Simd::lanes));
          Simd::store(place, sum);
        });
    return;
  }
  float sums[Unit::rows * Unit::lanes];
  const int64_t left = tile.columns - column, columns = left < Unit::lanes ? left : Unit::lanes;
  const int64_t rows = tile.rows;
  Unit::template multiply<kind>(
      tile.words, tile.a, tile.a_stride, b,
      Unit::lanes, [&](int m, int n, Vector all) __attribute__((always_inline)) {
        if (m >= rows) return;
        Simd::store(sums + m * Unit::lanes + n * Simd::lanes, scaled(m, n, all));
      });
  for (int64_t m = 0; m < rows; ++m) {
    for (int64_t n = 0; n < columns; ++n) {
      float sum = sums[m * Unit::lanes + n];
      if (!first) sum = y[m * tile.y_stride + n] + sum;
      if (bias != nullptr) sum += bias[n];
      y[m * tile.y_stride + n] = sum;
    }
  }
}

// column_scales and column_sums are readable up to whole panels.
template <class Unit, OperandKind kind>
void unit_product(const UnitProductTile& tile) {
  [[maybe_unused]] const typename Unit::Session session;
  for (int64_t column = 0; column < tile.columns; column += Unit::lanes) {
    product_of_panel<Unit, kind>(tile, column);
  }
}

void to_bfloat16(const float* x, int64_t count, int64_t padded, uint16_t* y) {
  int64_t i = 0;
  for (; i + Simd::lanes <= count; i += Simd::lanes) UnitSimd::store_bfloat16(y + i, Simd::load(x + i));
  for (; i < count; ++i) y[i] = bfloat16_of(x[i]);
  for (; i < padded; ++i) y[i] = 0;
}

ByteScale byte_scale(const float* x, int64_t count) {
  constexpr float kSmallest = 1.1754944e-38f;
  float lowest = 0, highest = 0, unfinite = 0;
  int64_t i = 0;
  if (count >= Simd::lanes) {
    Vector low = Simd::zero(), high = Simd::zero(), zeros = Simd::zero();
    for (; i + Simd::lanes <= count; i += Simd::lanes) {
      const Vector v = Simd::load(x + i);
      high = Simd::maximum(v, high);
      low = Simd::maximum(Simd::subtract(Simd::zero(), v), low);
      zeros = Simd::multiply_add(v, Simd::zero(), zeros);  // NaN where v is a NaN or infinite
    }
    float lows[Simd::lanes], highs[Simd::lanes];
    Simd::store(lows, low);
    Simd::store(highs, high);
    for (int lane = 0; lane < Simd::lanes; ++lane) {
      if (-lows[lane] < lowest) lowest = -lows[lane];
      if (highs[lane] > highest) highest = highs[lane];
    }
    unfinite = Simd::sum(zeros);
  }
  for (; i < count; ++i) {
    if (x[i] < lowest) lowest = x[i];
    if (x[i] > highest) highest = x[i];
    unfinite += x[i] * 0.0f;
  }
  ByteScale result = {highest / 255 - lowest / 255 + unfinite, 0};
  // Rows of such small numbers count as zero: the scale's inverse would be infinite.
  if (result.scale < kSmallest) return {0, 0};
  if (unfinite == 0) result.zero = static_cast<int32_t>(__builtin_nearbyintf(-lowest / result.scale));
  return result;
}

void to_bytes(const float* x, int64_t count, int64_t padded, const ByteScale& scale, uint8_t* y) {
  const float inverse = scale.scale > 0 ? 1 / scale.scale : 0;
  int64_t i = 0;
  for (; i + Simd::lanes <= count; i += Simd::lanes) {
    UnitSimd::store_bytes(y + i, Simd::load(x + i), inverse, scale.zero);
  }
  if (i < count) {
    float tail[Simd::lanes] = {};
    uint8_t bytes[Simd::lanes];
    for (int64_t j = i; j < count; ++j) tail[j - i] = x[j];
    UnitSimd::store_bytes(bytes, Simd::load(tail), inverse, scale.zero);
    for (; i < count; ++i) y[i] = bytes[i % Simd::lanes];
  }
  for (; i < padded; ++i) y[i] = 0;
}

template <class Unit, OperandKind kind>
double unit_rounds(int64_t rounds) {
  [[maybe_unused]] const typename Unit::Session session;
  return Unit::template rounds<kind>(rounds);
}

template <class Unit>
MatrixUnitKernels kernels_of(MatrixUnit unit) {
  MatrixUnitKernels kernels;
  kernels.unit = unit;
  kernels.rows = Unit::rows;
  kernels.lanes = Unit::lanes;
  kernels.step_words = Unit::step_words;
  kernels.block_words = Unit::block_words;
  kernels.block_columns = Unit::block_columns;
  kernels.forward_queries = kUnitGroups * Unit::lanes;
  kernels.forward_scratch = unit_forward_scratch<Unit>;
  kernels.backward_keys = kUnitGroups * Unit::lanes;
  kernels.backward_scratch = unit_backward_scratch<Unit>;
  kernels.bfloat16_product = unit_product<Unit, OperandKind::kBFloat16>;
  kernels.int8_product = unit_product<Unit, OperandKind::kInt8>;
  kernels.attention_forward = unit_attention_forward<Unit>;
  kernels.attention_backward = unit_attention_backward<Unit>;
  kernels.to_bfloat16 = to_bfloat16;
  kernels.byte_scale = byte_scale;
  kernels.to_bytes = to_bytes;
  kernels.bfloat16_rounds = unit_rounds<Unit, OperandKind::kBFloat16>;
  kernels.int8_rounds = unit_rounds<Unit, OperandKind::kInt8>;
  return kernels;
}

}  // namespace
}  // namespace gld
