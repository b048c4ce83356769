#pragma once

// Products, attention and conversions on any matrix unit, compiled once per unit (unit_simd.h). Unit is DotUnit or a
// TileUnit. The lanes of attention's vectors are queries, so that maxima, sums and exponentials never cross lanes.

#include "gld/kernels/matrix_unit_kernels.h"
#include "gld/kernels/quads.h"
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

constexpr int64_t kQueryGroups = 4;

// Scratch of one group of queries: its queries and running sums, transposed, and two rows of lane values.
template <class Unit>
GLD_INLINE int64_t unit_group_floats(int64_t head_words, int64_t head_rows) {
  return (head_words + head_rows + 2) * Unit::lanes;
}

// Behind the groups: logits of a block of keys, and its probabilities as pairs.
template <class Unit>
int64_t unit_forward_scratch(int64_t head_words, int64_t head_rows) {
  return kQueryGroups * unit_group_floats<Unit>(head_words, head_rows) +
         (kBlockKeys + kBlockKeyWords) * Unit::lanes;
}

// transposed (words, Unit::lanes) = rows (count, words); lanes past count are zero.
template <class Unit>
GLD_INLINE void transpose_words(const uint32_t* rows, int64_t count, int64_t words, float* transposed) {
  for (int64_t lane = 0; lane < Unit::lanes; lane += 4) {
    for (int64_t w = 0; w < words; w += 4) {
      Quad q[4];
#pragma GCC unroll 4
      for (int i = 0; i < 4; ++i) {
        if (lane + i < count) {
          __builtin_memcpy(&q[i], rows + (lane + i) * words + w, sizeof(Quad));
        } else {
          q[i] = Quad{0, 0, 0, 0};
        }
      }
      transpose_quads(q);
#pragma GCC unroll 4
      for (int i = 0; i < 4; ++i) store_quad(transposed + (w + i) * Unit::lanes + lane, q[i]);
    }
  }
}

GLD_INLINE const uint32_t* words_at(const float* p) { return reinterpret_cast<const uint32_t*>(p); }

// One step of the online softmax, as forward_step of attention_tiles.h: a block of keys for one group of queries.
template <class Unit>
GLD_INLINE void unit_forward_step(const UnitAttentionTile& tile, int64_t block, float* group, float* logits,
                                  uint32_t* pairs) {
  constexpr int64_t lanes = Unit::lanes;
  const int64_t count = tile.block_keys[block];
  const int64_t words = round_up(round_up(count, 2) / 2, Unit::step_words);
  float* sums = group + tile.head_words * lanes;
  float* maxima = sums + tile.head_rows * lanes;
  float* totals = maxima + lanes;
  Vector highest[Unit::vectors], rescale[Unit::vectors], block_total[Unit::vectors];
#pragma GCC unroll 8
  for (int n = 0; n < Unit::vectors; ++n) highest[n] = Simd::load(maxima + n * Simd::lanes);
  const uint32_t* keys = tile.keys + block * kBlockKeys * tile.head_words;
  const int64_t depth = round_up(tile.head_dim / 2, Unit::step_words);
  for (int64_t first = 0; first < 2 * words; first += Unit::rows) {
    float* rows = logits + first * lanes;
    Unit::template multiply<OperandKind::kBFloat16>(
        depth, keys + first * tile.head_words, tile.head_words, words_at(group),
        lanes, [&](int m, int n, Vector sum) __attribute__((always_inline)) {
          const Vector logit = first + m < count ? sum : Simd::broadcast(kLowest);
          Simd::store(rows + m * lanes + n * Simd::lanes, logit);
          highest[n] = Simd::maximum(logit, highest[n]);
        });
  }
#pragma GCC unroll 8
  for (int n = 0; n < Unit::vectors; ++n) {
    rescale[n] = Simd::exp2(Simd::subtract(Simd::load(maxima + n * Simd::lanes), highest[n]));
    Simd::store(maxima + n * Simd::lanes, highest[n]);
    block_total[n] = Simd::zero();
  }
  for (int64_t w = 0; w < words; ++w) {
#pragma GCC unroll 8
    for (int n = 0; n < Unit::vectors; ++n) {
      const float* place = logits + 2 * w * lanes + n * Simd::lanes;
      const Vector even = UnitSimd::exp2(Simd::subtract(Simd::load(place), highest[n]));
      const Vector odd = UnitSimd::exp2(Simd::subtract(Simd::load(place + lanes), highest[n]));
      UnitSimd::store_pairs(pairs + w * lanes + n * Simd::lanes, even, odd);
      block_total[n] = Simd::add(block_total[n], Simd::add(even, odd));
    }
  }
#pragma GCC unroll 8
  for (int n = 0; n < Unit::vectors; ++n) {
    float* place = totals + n * Simd::lanes;
    Simd::store(place, Simd::multiply_add(Simd::load(place), rescale[n], block_total[n]));
  }
  const uint32_t* values = tile.values + block * kBlockKeyWords * tile.head_rows;
  for (int64_t channel = 0; channel < tile.head_dim; channel += Unit::rows) {
    float* rows = sums + channel * lanes;
    Unit::template multiply<OperandKind::kBFloat16>(
        words, values + channel * kBlockKeyWords, kBlockKeyWords, pairs,
        lanes, [&](int m, int n, Vector sum) __attribute__((always_inline)) {
          float* place = rows + m * lanes + n * Simd::lanes;
          Simd::store(place, Simd::multiply_add(Simd::load(place), rescale[n], sum));
        });
  }
}

// rows (count, stride) = factors (a lane each) times transposed (head_dim, Unit::lanes).
template <class Unit>
GLD_INLINE void transpose_sums(const float* transposed, const float* factors, int64_t count, int64_t stride,
                               int64_t head_dim, float* rows) {
  for (int64_t lane = 0; lane < count; lane += 4) {
    const Quad factor = load_quad(factors + lane);
    for (int64_t c = 0; c < head_dim; c += 4) {
      Quad q[4];
#pragma GCC unroll 4
      for (int i = 0; i < 4; ++i) q[i] = load_quad(transposed + (c + i) * Unit::lanes + lane) * factor;
      transpose_quads(q);
      for (int i = 0; i < 4 && lane + i < count; ++i) store_quad(rows + (lane + i) * stride + c, q[i]);
    }
  }
}

template <class Unit>
void unit_attention_forward(const UnitAttentionTile& tile) {
  [[maybe_unused]] const typename Unit::Session session;
  constexpr int64_t lanes = Unit::lanes;
  const int64_t group_floats = unit_group_floats<Unit>(tile.head_words, tile.head_rows);
  const int64_t groups = round_up(tile.query_count, lanes) / lanes;
  float* logits = tile.scratch + kQueryGroups * group_floats;
  auto* pairs = reinterpret_cast<uint32_t*>(logits + kBlockKeys * lanes);
  const auto group_queries = [&](int64_t g) {
    const int64_t left = tile.query_count - g * lanes;
    return left < lanes ? left : lanes;
  };
  for (int64_t g = 0; g < groups; ++g) {
    float* group = tile.scratch + g * group_floats;
    transpose_words<Unit>(tile.queries + g * lanes * tile.head_words, group_queries(g), tile.head_words,
                          group);
    float* sums = group + tile.head_words * lanes;
    float* maxima = sums + tile.head_rows * lanes;
    for (int64_t i = 0; i < tile.head_rows * lanes; ++i) sums[i] = 0;
    for (int64_t i = 0; i < lanes; ++i) maxima[i] = kLowest;
    for (int64_t i = 0; i < lanes; ++i) maxima[lanes + i] = 0;
  }
  for (int64_t r = 0; r < tile.block_range_count; ++r) {
    const TokenRange& range = tile.block_ranges[r];
    for (int64_t block = range.first; block < range.first + range.count; ++block) {
      for (int64_t g = 0; g < groups; ++g) {
        unit_forward_step<Unit>(tile, block, tile.scratch + g * group_floats, logits, pairs);
      }
    }
  }
  for (int64_t g = 0; g < groups; ++g) {
    const float* sums = tile.scratch + g * group_floats + tile.head_words * lanes;
    const float* maxima = sums + tile.head_rows * lanes;
    float* totals = tile.scratch + g * group_floats + (tile.head_words + tile.head_rows + 1) * lanes;
    const int64_t count = group_queries(g);
    for (int64_t lane = 0; lane < count; ++lane) {
      tile.base2_lse[g * lanes + lane] =
          totals[lane] == 0 ? kLowest : maxima[lane] + __builtin_log2f(totals[lane]);
    }
    for (int64_t lane = 0; lane < lanes; ++lane) totals[lane] = totals[lane] == 0 ? 0 : 1 / totals[lane];
    transpose_sums<Unit>(sums, totals, count, tile.output_stride, tile.head_dim,
                         tile.output + g * lanes * tile.output_stride);
  }
}

void to_bfloat16(const float* x, int64_t count, int64_t padded, uint16_t* y) {
  int64_t i = 0;
  for (; i + Simd::lanes <= count; i += Simd::lanes) UnitSimd::store_bfloat16(y + i, Simd::load(x + i));
  for (; i < count; ++i) y[i] = bfloat16_of(x[i]);
  for (; i < padded; ++i) y[i] = 0;
}

void split_bfloat16(const float* x, int64_t count, int64_t padded, uint16_t* high, uint16_t* low) {
  int64_t i = 0;
  for (; i + Simd::lanes <= count; i += Simd::lanes) {
    const Vector all = Simd::load(x + i);
    UnitSimd::store_bfloat16(high + i, all);
    UnitSimd::store_bfloat16(low + i, Simd::subtract(all, UnitSimd::load_bfloat16(high + i)));
  }
  for (; i < count; ++i) {
    high[i] = bfloat16_of(x[i]);
    low[i] = bfloat16_of(x[i] - float_of(high[i]));
  }
  for (; i < padded; ++i) high[i] = low[i] = 0;
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
  return {unit,
          Unit::rows,
          Unit::lanes,
          Unit::step_words,
          Unit::block_words,
          Unit::block_columns,
          kQueryGroups * Unit::lanes,
          unit_forward_scratch<Unit>,
          unit_product<Unit, OperandKind::kBFloat16>,
          unit_product<Unit, OperandKind::kInt8>,
          unit_attention_forward<Unit>,
          to_bfloat16,
          split_bfloat16,
          byte_scale,
          to_bytes,
          unit_rounds<Unit, OperandKind::kBFloat16>,
          unit_rounds<Unit, OperandKind::kInt8>};
}

}  // namespace
}  // namespace gld
