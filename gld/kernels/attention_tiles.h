#pragma once

// Attention in tiles, compiled once per instruction set (see simd.h). The lanes of every vector are queries
// in the forward pass and keys in the backward pass, so that maxima, sums and exponentials never cross lanes.

#include "gld/kernels/kernel_table.h"
#include "gld/kernels/quads.h"
#include "gld/kernels/simd.h"

namespace gld {
namespace {

constexpr int64_t kTileLanes = Simd::lanes * Simd::tile_vectors;
constexpr int kTileRows = Simd::tile_rows;
constexpr int kTileVectors = Simd::tile_vectors;
// A step takes so many keys: their probabilities for one tile of queries stay in the first-level cache.
constexpr int64_t kForwardKeys = 96;
constexpr int64_t kForwardGroups = 4;
constexpr int64_t kBackwardGroups = 4;
constexpr int64_t kBackwardQueries = 64;

// Writes transposed (head_dim, kTileLanes) from rows (count, stride); lanes past count are zero. head_dim is a multiple
// of 4.
GLD_INLINE void transpose_rows(const float* rows, int64_t count, int64_t stride, int64_t head_dim,
                               float* transposed) {
  for (int64_t lane = 0; lane < kTileLanes; lane += 4) {
    for (int64_t c = 0; c < head_dim; c += 4) {
      Quad q[4];
#pragma GCC unroll 4
      for (int i = 0; i < 4; ++i) {
        q[i] = lane + i < count ? load_quad(rows + (lane + i) * stride + c) : Quad{0, 0, 0, 0};
      }
      transpose_quads(q);
#pragma GCC unroll 4
      for (int i = 0; i < 4; ++i) store_quad(transposed + (c + i) * kTileLanes + lane, q[i]);
    }
  }
}

// Returns the scratch of one group of kTileLanes queries: its queries and running sums, transposed, and two rows of
// lane values.
GLD_INLINE int64_t forward_group_floats(int64_t head_dim) { return (2 * head_dim + 2) * kTileLanes; }

int64_t forward_scratch_floats(int64_t head_dim) {
  return kForwardGroups * forward_group_floats(head_dim) + (kForwardKeys + kTileRows) * kTileLanes;
}

// Computes the logits of `count` keys, written to (round_up(count, kTileRows), kTileLanes); rows past count get -inf.
GLD_INLINE void logits_tile(const AttentionForwardTile& tile, const float* transposed_queries,
                            const float* keys, int64_t count, float* logits,
                            Vector (&highest)[kTileVectors]) {
  for (int64_t first = 0; first < count; first += kTileRows) {
    Vector c[kTileRows][kTileVectors];
    clear_tile(c);
    multiply_tile<kTileRows, kTileVectors>(tile.head_dim, keys + first * tile.stride, 1, tile.stride,
                                           transposed_queries, kTileLanes, c);
    if (first + kTileRows > count) {
#pragma GCC unroll 8
      for (int m = 0; m < kTileRows; ++m) {
        if (first + m < count) continue;
#pragma GCC unroll 8
        for (int n = 0; n < kTileVectors; ++n) c[m][n] = Simd::broadcast(kLowest);
      }
    }
#pragma GCC unroll 8
    for (int m = 0; m < kTileRows; ++m) {
#pragma GCC unroll 8
      for (int n = 0; n < kTileVectors; ++n) {
        Simd::store(logits + (first + m) * kTileLanes + n * Simd::lanes, c[m][n]);
        highest[n] = Simd::maximum(c[m][n], highest[n]);
      }
    }
  }
}

// Takes one step of the online softmax: a block of keys for one group of queries. The sums over the block start from
// zero and are added to the running sums afterwards: two short sums round less than a long one, and rescaling the
// running sum to a new maximum costs nothing.
GLD_INLINE void forward_step(const AttentionForwardTile& tile, int64_t first_key, int64_t count, float* group,
                             float* probabilities) {
  const int64_t head_dim = tile.head_dim;
  const int64_t padded = round_up(count, kTileRows);
  const float* transposed_queries = group;
  float* sums = group + head_dim * kTileLanes;
  float* maxima = sums + head_dim * kTileLanes;
  float* totals = maxima + kTileLanes;
  Vector highest[kTileVectors];
  Vector rescale[kTileVectors];
  Vector block_total[kTileVectors];
#pragma GCC unroll 8
  for (int n = 0; n < kTileVectors; ++n) highest[n] = Simd::load(maxima + n * Simd::lanes);
  logits_tile(tile, transposed_queries, tile.keys + first_key * tile.stride, count, probabilities, highest);
#pragma GCC unroll 8
  for (int n = 0; n < kTileVectors; ++n) {
    rescale[n] = Simd::exp2(Simd::subtract(Simd::load(maxima + n * Simd::lanes), highest[n]));
    Simd::store(maxima + n * Simd::lanes, highest[n]);
    block_total[n] = Simd::zero();
  }
  for (int64_t k = 0; k < padded; ++k) {
#pragma GCC unroll 8
    for (int n = 0; n < kTileVectors; ++n) {
      float* place = probabilities + k * kTileLanes + n * Simd::lanes;
      const Vector p = Simd::exp2(Simd::subtract(Simd::load(place), highest[n]));
      Simd::store(place, p);
      block_total[n] = Simd::add(block_total[n], p);
    }
  }
#pragma GCC unroll 8
  for (int n = 0; n < kTileVectors; ++n) {
    float* place = totals + n * Simd::lanes;
    Simd::store(place, Simd::multiply_add(Simd::load(place), rescale[n], block_total[n]));
  }
  for (int64_t channel = 0; channel < head_dim; channel += kTileRows) {
    Vector c[kTileRows][kTileVectors];
    clear_tile(c);
    multiply_tile<kTileRows, kTileVectors>(padded, tile.values + first_key * tile.stride + channel,
                                           tile.stride, 1, probabilities, kTileLanes, c);
#pragma GCC unroll 8
    for (int m = 0; m < kTileRows; ++m) {
#pragma GCC unroll 8
      for (int n = 0; n < kTileVectors; ++n) {
        float* place = sums + (channel + m) * kTileLanes + n * Simd::lanes;
        Simd::store(place, Simd::multiply_add(Simd::load(place), rescale[n], c[m][n]));
      }
    }
  }
}

// Online softmax (Milakov and Gimelshein 2018) over blocks of keys, as in FlashAttention (Dao 2022, algorithm 1).
// Several groups of queries share a block while it is in the second-level cache.
void attention_forward_tile(const AttentionForwardTile& tile) {
  const int64_t head_dim = tile.head_dim;
  const int64_t group_floats = forward_group_floats(head_dim);
  const int64_t groups = round_up(tile.query_count, kTileLanes) / kTileLanes;
  float* probabilities = tile.scratch + kForwardGroups * group_floats;
  for (int64_t g = 0; g < groups; ++g) {
    float* group = tile.scratch + g * group_floats;
    const int64_t left = tile.query_count - g * kTileLanes;
    transpose_rows(tile.queries + g * kTileLanes * tile.stride, left < kTileLanes ? left : kTileLanes,
                   tile.stride, head_dim, group);
    float* sums = group + head_dim * kTileLanes;
    float* maxima = sums + head_dim * kTileLanes;
    for (int64_t i = 0; i < head_dim * kTileLanes; ++i) sums[i] = 0;
    for (int64_t i = 0; i < kTileLanes; ++i) maxima[i] = kLowest;
    for (int64_t i = 0; i < kTileLanes; ++i) maxima[kTileLanes + i] = 0;
  }
  for (int64_t first = 0; first < tile.key_count; first += kForwardKeys) {
    const int64_t left = tile.key_count - first;
    const int64_t count = left < kForwardKeys ? left : kForwardKeys;
    for (int64_t g = 0; g < groups; ++g) {
      forward_step(tile, first, count, tile.scratch + g * group_floats, probabilities);
    }
  }
  for (int64_t g = 0; g < groups; ++g) {
    const float* sums = tile.scratch + g * group_floats + head_dim * kTileLanes;
    const float* maxima = sums + head_dim * kTileLanes;
    float* totals = tile.scratch + g * group_floats + (2 * head_dim + 1) * kTileLanes;
    const int64_t left = tile.query_count - g * kTileLanes;
    const int64_t count = left < kTileLanes ? left : kTileLanes;
    for (int64_t lane = 0; lane < count; ++lane) {
      tile.base2_lse[g * kTileLanes + lane] =
          totals[lane] == 0 ? kLowest : maxima[lane] + __builtin_log2f(totals[lane]);
    }
    for (int64_t lane = 0; lane < kTileLanes; ++lane) totals[lane] = totals[lane] == 0 ? 0 : 1 / totals[lane];
    transpose_back<kTileLanes>(sums, totals, count, tile.stride, head_dim,
                               tile.output + g * kTileLanes * tile.stride);
  }
}

// Returns the scratch of one group of kTileLanes keys: keys, values and the sums of their gradients, transposed.
GLD_INLINE int64_t backward_group_floats(int64_t head_dim) { return 4 * head_dim * kTileLanes; }

int64_t backward_scratch_floats(int64_t head_dim) {
  return kBackwardGroups * backward_group_floats(head_dim) + 2 * (kBackwardQueries + kTileRows) * kTileLanes;
}

// query_gradients rows += logit gradients (count, kTileLanes) times key rows, one strip of channels.
template <int vectors>
GLD_INLINE void add_query_gradients(const AttentionBackwardTile& tile, const TokenRange& keys,
                                    const float* logit_gradients, int64_t count, float* rows,
                                    int64_t channel) {
  for (int64_t first = 0; first < count; first += kTileRows) {
    Vector c[kTileRows][vectors];
    clear_tile(c);
    multiply_tile<kTileRows, vectors>(keys.count, logit_gradients + first * kTileLanes, 1, kTileLanes,
                                      tile.keys + keys.first * tile.stride + channel, tile.stride, c);
#pragma GCC unroll 8
    for (int m = 0; m < kTileRows; ++m) {
      // Rows past count belong to other queries.
      if (first + m >= count) break;
#pragma GCC unroll 8
      for (int n = 0; n < vectors; ++n) {
        float* place = rows + (first + m) * tile.stride + channel + n * Simd::lanes;
        Simd::store(place, Simd::add(Simd::load(place), c[m][n]));
      }
    }
  }
}

// sums (head_dim, kTileLanes) += rows^T (count, head_dim) times weights (count, kTileLanes).
GLD_INLINE void add_transposed_product(const float* rows, const float* weights, int64_t count, int64_t stride,
                                       int64_t head_dim, float* sums) {
  for (int64_t channel = 0; channel < head_dim; channel += kTileRows) {
    Vector c[kTileRows][kTileVectors];
    clear_tile(c);
    multiply_tile<kTileRows, kTileVectors>(count, rows + channel, stride, 1, weights, kTileLanes, c);
#pragma GCC unroll 8
    for (int m = 0; m < kTileRows; ++m) {
#pragma GCC unroll 8
      for (int n = 0; n < kTileVectors; ++n) {
        float* place = sums + (channel + m) * kTileLanes + n * Simd::lanes;
        Simd::store(place, Simd::add(Simd::load(place), c[m][n]));
      }
    }
  }
}

// Computes probabilities and logit gradients, (count, kTileLanes) each, of a block of queries and a group of keys:
// P = 2^(logit - lse) and dS = P (dP - output . output gradient).
GLD_INLINE void logit_gradient_tile(const AttentionBackwardTile& tile, int64_t start, int64_t count,
                                    const float* transposed_keys, const float* transposed_values,
                                    float* probabilities, float* logit_gradients) {
  const float* queries = tile.queries + start * tile.stride;
  const float* output_gradients = tile.output_gradients + start * tile.stride;
  for (int64_t first = 0; first < count; first += kTileRows) {
    Vector c[kTileRows][kTileVectors];
    clear_tile(c);
    multiply_tile<kTileRows, kTileVectors>(tile.head_dim, queries + first * tile.stride, 1, tile.stride,
                                           transposed_keys, kTileLanes, c);
#pragma GCC unroll 8
    for (int m = 0; m < kTileRows; ++m) {
      // The two tables have no padding; rows past count are never used.
      const int64_t row = first + m < count ? first + m : count - 1;
      const Vector lse = Simd::broadcast(tile.base2_lse[start + row]);
#pragma GCC unroll 8
      for (int n = 0; n < kTileVectors; ++n) {
        Simd::store(probabilities + (first + m) * kTileLanes + n * Simd::lanes,
                    Simd::exp2(Simd::subtract(c[m][n], lse)));
      }
    }
    clear_tile(c);
    multiply_tile<kTileRows, kTileVectors>(tile.head_dim, output_gradients + first * tile.stride, 1,
                                           tile.stride, transposed_values, kTileLanes, c);
#pragma GCC unroll 8
    for (int m = 0; m < kTileRows; ++m) {
      const int64_t row = first + m < count ? first + m : count - 1;
      const Vector dot = Simd::broadcast(tile.output_dot[start + row]);
#pragma GCC unroll 8
      for (int n = 0; n < kTileVectors; ++n) {
        const int64_t place = (first + m) * kTileLanes + n * Simd::lanes;
        Simd::store(logit_gradients + place,
                    Simd::multiply(Simd::load(probabilities + place), Simd::subtract(c[m][n], dot)));
      }
    }
  }
}

// Takes the step of a block of queries and one group of keys.
GLD_INLINE void backward_step(const AttentionBackwardTile& tile, int64_t start, int64_t count,
                              const TokenRange& keys, float* group, float* probabilities) {
  const int64_t head_dim = tile.head_dim;
  const int64_t matrix = head_dim * kTileLanes;
  float* logit_gradients = probabilities + (kBackwardQueries + kTileRows) * kTileLanes;
  logit_gradient_tile(tile, start, count, group, group + matrix, probabilities, logit_gradients);
  add_transposed_product(tile.queries + start * tile.stride, logit_gradients, count, tile.stride, head_dim,
                         group + 2 * matrix);
  add_transposed_product(tile.output_gradients + start * tile.stride, probabilities, count, tile.stride,
                         head_dim, group + 3 * matrix);
  float* query_gradients = tile.query_gradients + start * tile.stride;
  int64_t channel = 0;
  for (; channel + 2 * Simd::lanes < head_dim; channel += 3 * Simd::lanes) {
    add_query_gradients<3>(tile, keys, logit_gradients, count, query_gradients, channel);
  }
  for (; channel + Simd::lanes < head_dim; channel += 2 * Simd::lanes) {
    add_query_gradients<2>(tile, keys, logit_gradients, count, query_gradients, channel);
  }
  for (; channel < head_dim; channel += Simd::lanes) {
    add_query_gradients<1>(tile, keys, logit_gradients, count, query_gradients, channel);
  }
}

// FlashAttention's backward pass (Dao 2023, algorithm 2) for some keys: probabilities are recomputed from the stored
// log-sum-exp. Several groups of keys share a block of queries while it is in the second-level cache.
void attention_backward_tile(const AttentionBackwardTile& tile) {
  const int64_t head_dim = tile.head_dim;
  const int64_t matrix = head_dim * kTileLanes;
  const int64_t group_floats = backward_group_floats(head_dim);
  const int64_t groups = round_up(tile.key_count, kTileLanes) / kTileLanes;
  float* probabilities = tile.scratch + kBackwardGroups * group_floats;
  TokenRange keys[kBackwardGroups];
  for (int64_t g = 0; g < groups; ++g) {
    float* group = tile.scratch + g * group_floats;
    const int64_t left = tile.key_count - g * kTileLanes;
    keys[g] = {g * kTileLanes, left < kTileLanes ? left : kTileLanes};
    transpose_rows(tile.keys + keys[g].first * tile.stride, keys[g].count, tile.stride, head_dim, group);
    transpose_rows(tile.values + keys[g].first * tile.stride, keys[g].count, tile.stride, head_dim,
                   group + matrix);
    for (int64_t i = 0; i < 2 * matrix; ++i) group[2 * matrix + i] = 0;
  }
  for (int64_t first = 0; first < tile.query_count; first += kBackwardQueries) {
    const int64_t left = tile.query_count - first;
    const int64_t count = left < kBackwardQueries ? left : kBackwardQueries;
    for (int64_t g = 0; g < groups; ++g) {
      backward_step(tile, first, count, keys[g], tile.scratch + g * group_floats, probabilities);
    }
  }
  for (int64_t lane = 0; lane < kTileLanes; ++lane) probabilities[lane] = 1;
  for (int64_t g = 0; g < groups; ++g) {
    const float* sums = tile.scratch + g * group_floats + 2 * matrix;
    const int64_t offset = keys[g].first * tile.stride;
    transpose_back<kTileLanes>(sums, probabilities, keys[g].count, tile.stride, head_dim,
                               tile.key_gradients + offset);
    transpose_back<kTileLanes>(sums + matrix, probabilities, keys[g].count, tile.stride, head_dim,
                               tile.value_gradients + offset);
  }
}

GLD_INLINE void scale_row(int64_t count, float factor, const float* __restrict x, float* __restrict y) {
  const Vector factors = Simd::broadcast(factor);
  int64_t c = 0;
  for (; c + Simd::lanes <= count; c += Simd::lanes) {
    Simd::store(y + c, Simd::multiply(Simd::load(x + c), factors));
  }
  for (; c < count; ++c) y[c] = x[c] * factor;
}

// Does the 4x4 products on the first half of the channels. A whole vector may spill into the second half of y, which is
// written afterwards.
GLD_INLINE void multiply_groups(const PropeRow& encoding, int64_t head_dim, float factor,
                                const float* __restrict x, float* __restrict y) {
  float columns[4][4];
  for (int i = 0; i < 4; ++i) {
    for (int j = 0; j < 4; ++j) {
      columns[j][i] = factor * encoding.matrix[encoding.transposed_matrix ? 4 * j + i : 4 * i + j];
    }
  }
  const Vector column0 = Simd::load_repeated4(columns[0]);
  const Vector column1 = Simd::load_repeated4(columns[1]);
  const Vector column2 = Simd::load_repeated4(columns[2]);
  const Vector column3 = Simd::load_repeated4(columns[3]);
  int64_t c = 0;
  for (; c < head_dim / 2 && c + Simd::lanes <= head_dim; c += Simd::lanes) {
    const Vector v = Simd::load(x + c);
    Vector sum = Simd::multiply(column0, Simd::spread<0>(v));
    sum = Simd::multiply_add(column1, Simd::spread<1>(v), sum);
    sum = Simd::multiply_add(column2, Simd::spread<2>(v), sum);
    Simd::store(y + c, Simd::multiply_add(column3, Simd::spread<3>(v), sum));
  }
  for (; c < head_dim / 2; c += 4) {
    for (int i = 0; i < 4; ++i) {
      y[c + i] = columns[0][i] * x[c] + columns[1][i] * x[c + 1] + columns[2][i] * x[c + 2] +
                 columns[3][i] * x[c + 3];
    }
  }
}

// See PropeRow. Quarters rotate in split halves: (cos a + sin b, cos b - sin a), or with -sin for the inverse.
void encode_packed_row(const PropeRow* encoding, int64_t head_dim, float factor, const float* __restrict x,
                       float* __restrict y) {
  if (encoding == nullptr) {
    scale_row(head_dim, factor, x, y);
    return;
  }
  multiply_groups(*encoding, head_dim, factor, x, y);
  const int64_t eighth = head_dim / 8;
  const float signed_factor = encoding->inverse_rotation ? -factor : factor;
  const float* cosines[2] = {encoding->column_cos, encoding->row_cos};
  const float* sines[2] = {encoding->column_sin, encoding->row_sin};
  for (int quarter = 0; quarter < 2; ++quarter) {
    const float* a = x + head_dim / 2 + quarter * 2 * eighth;
    const float* b = a + eighth;
    float* out = y + head_dim / 2 + quarter * 2 * eighth;
    for (int64_t c = 0; c < eighth; ++c) {
      const float cosine = factor * cosines[quarter][c];
      const float sine = signed_factor * sines[quarter][c];
      out[c] = cosine * a[c] + sine * b[c];
      out[eighth + c] = cosine * b[c] - sine * a[c];
    }
  }
}

}  // namespace
}  // namespace gld
