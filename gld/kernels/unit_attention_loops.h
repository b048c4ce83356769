#pragma once

// Attention on any matrix unit, forward and backward, compiled once per unit (unit_simd.h). Unit is DotUnit or a
// TileUnit. The lanes of every vector are queries in the forward pass and keys in the backward pass, so that maxima,
// sums and exponentials never cross lanes.

#include "gld/kernels/matrix_unit_kernels.h"
#include "gld/kernels/quads.h"
#include "gld/kernels/unit_simd.h"

namespace gld {
namespace {

// So many groups of queries in the forward pass and of keys in the backward pass, a vector register set each, share a
// block.
constexpr int64_t kUnitGroups = 4;

// Returns the scratch of one group of queries: its queries and running sums, transposed, and two rows of lane values.
template <class Unit>
GLD_INLINE int64_t unit_group_floats(int64_t head_words, int64_t head_rows) {
  return (head_words + head_rows + 2) * Unit::lanes;
}

// Behind the groups lie the logits of a block of keys, and its probabilities as pairs.
template <class Unit>
int64_t unit_forward_scratch(int64_t head_words, int64_t head_rows) {
  return kUnitGroups * unit_group_floats<Unit>(head_words, head_rows) +
         (kBlockTokens + kBlockPairs) * Unit::lanes;
}

// Writes transposed (words, Unit::lanes) from rows (count, words); lanes past count are zero.
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

// Takes one step of the online softmax, as forward_step of attention_tiles.h does: a block of keys for one group of
// queries.
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
  const uint32_t* keys = tile.keys + block * kBlockTokens * tile.head_words;
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
  const uint32_t* values = tile.values + block * kBlockPairs * tile.head_rows;
  for (int64_t channel = 0; channel < tile.head_dim; channel += Unit::rows) {
    float* rows = sums + channel * lanes;
    Unit::template multiply<OperandKind::kBFloat16>(
        words, values + channel * kBlockPairs, kBlockPairs, pairs,
        lanes, [&](int m, int n, Vector sum) __attribute__((always_inline)) {
          float* place = rows + m * lanes + n * Simd::lanes;
          Simd::store(place, Simd::multiply_add(Simd::load(place), rescale[n], sum));
        });
  }
}

template <class Unit>
void unit_attention_forward(const UnitAttentionTile& tile) {
  [[maybe_unused]] const typename Unit::Session session;
  constexpr int64_t lanes = Unit::lanes;
  const int64_t group_floats = unit_group_floats<Unit>(tile.head_words, tile.head_rows);
  const int64_t groups = round_up(tile.query_count, lanes) / lanes;
  float* logits = tile.scratch + kUnitGroups * group_floats;
  auto* pairs = reinterpret_cast<uint32_t*>(logits + kBlockTokens * lanes);
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
  for (int64_t block = 0; block < tile.blocks; ++block) {
    for (int64_t g = 0; g < groups; ++g) {
      unit_forward_step<Unit>(tile, block, tile.scratch + g * group_floats, logits, pairs);
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
    transpose_back<Unit::lanes>(sums, totals, count, tile.output_stride, tile.head_dim,
                                tile.output + g * lanes * tile.output_stride);
  }
}

// What one group of keys of the backward pass keeps, and what the groups use in turns.
template <class Unit>
struct UnitBackwardScratch {
  static constexpr int64_t lanes = Unit::lanes;
  static constexpr int64_t pair_words = lanes / 2;  // pairs of the group's keys
  static_assert(pair_words % Unit::step_words == 0 && kBlockTokens % Unit::rows == 0,
                "gradients of queries are products of whole strips of rows and whole steps");

  float* keys;                  // (head_words, lanes): transposed
  float* values;                // the same
  float* key_pairs;             // for each panel of `lanes` channels (pair_words, lanes)
  float* key_sums;              // (head_rows, lanes): gradients, transposed
  float* value_sums;            // the same
  float* probabilities;         // (kBlockTokens, lanes)
  float* logit_gradients;       // the same
  float* probability_pairs;     // (kBlockPairs, lanes): two queries each
  float* logit_gradient_pairs;  // the same
  float* logit_gradient_rows;   // (kBlockTokens, pair_words): two keys each

  static GLD_INLINE int64_t group_floats(int64_t head_words, int64_t head_rows) {
    return (2 * head_words + 2 * head_rows + round_up(head_rows, lanes) / lanes * pair_words) * lanes;
  }
  static GLD_INLINE int64_t floats(int64_t head_words, int64_t head_rows) {
    return kUnitGroups * group_floats(head_words, head_rows) + (2 * kBlockTokens + 2 * kBlockPairs) * lanes +
           kBlockTokens * pair_words;
  }

  GLD_INLINE UnitBackwardScratch(float* scratch, int64_t group, int64_t head_words, int64_t head_rows) {
    keys = scratch + group * group_floats(head_words, head_rows);
    values = keys + head_words * lanes;
    key_sums = values + head_words * lanes;
    value_sums = key_sums + head_rows * lanes;
    key_pairs = value_sums + head_rows * lanes;
    probabilities = scratch + kUnitGroups * group_floats(head_words, head_rows);
    logit_gradients = probabilities + kBlockTokens * lanes;
    probability_pairs = logit_gradients + kBlockTokens * lanes;
    logit_gradient_pairs = probability_pairs + kBlockPairs * lanes;
    logit_gradient_rows = logit_gradient_pairs + kBlockPairs * lanes;
  }
};

template <class Unit>
int64_t unit_backward_scratch(int64_t head_words, int64_t head_rows) {
  return UnitBackwardScratch<Unit>::floats(head_words, head_rows);
}

GLD_INLINE uint32_t* words_at(float* p) { return reinterpret_cast<uint32_t*>(p); }

// key_pairs[panel][w][c] becomes channel c of keys 2w (low half) and 2w + 1 (high half), zero where there is no such
// key.
template <class Unit>
GLD_INLINE void pair_keys(const UnitAttentionBackwardTile& tile, const uint32_t* keys, int64_t count,
                          uint32_t* pairs) {
  constexpr int64_t lanes = Unit::lanes, pair_words = lanes / 2;
  const int64_t panels = round_up(tile.head_rows, lanes) / lanes;
  __builtin_memset(pairs, 0, static_cast<unsigned long>(panels * pair_words * lanes) * sizeof(uint32_t));
  for (int64_t key = 0; key < count; ++key) {
    const auto* row = reinterpret_cast<const uint16_t*>(keys + key * tile.head_words);
    auto* halves = reinterpret_cast<uint16_t*>(pairs + key / 2 * lanes) + key % 2;
    for (int64_t panel = 0; panel < panels; ++panel) {
      const int64_t first = panel * lanes;
      const int64_t left = tile.head_dim - first, channels = left < lanes ? left : lanes;
      uint16_t* to = halves + 2 * panel * pair_words * lanes;
      for (int64_t c = 0; c < channels; ++c) to[2 * c] = row[first + c];
    }
  }
}

// Computes P = 2^(logit - lse) and dS = P (dP - output . output gradient) of a block of queries and a group of keys, as
// pairs of queries and, dS, as pairs of keys; zero for queries and keys that are not there. Returns the words of a
// column of pairs.
template <class Unit>
GLD_INLINE int64_t unit_logit_gradients(const UnitAttentionBackwardTile& tile, int64_t block, int64_t keys,
                                        const UnitBackwardScratch<Unit>& scratch) {
  constexpr int64_t lanes = Unit::lanes;
  const int64_t count = tile.block_queries[block];
  const int64_t words = round_up(round_up(count, 2) / 2, Unit::step_words);
  const int64_t depth = round_up(tile.head_dim / 2, Unit::step_words);
  const uint32_t* queries = tile.queries + block * kBlockTokens * tile.head_words;
  const uint32_t* gradients = tile.output_gradients + block * kBlockTokens * tile.head_words;
  const float* lse = tile.base2_lse + block * kBlockTokens;
  const float* dot = tile.output_dot + block * kBlockTokens;
  for (int64_t first = 0; first < 2 * words; first += Unit::rows) {
    float* probabilities = scratch.probabilities + first * lanes;
    float* logit_gradients = scratch.logit_gradients + first * lanes;
    Unit::template multiply<OperandKind::kBFloat16>(
        depth, queries + first * tile.head_words, tile.head_words, words_at(scratch.keys),
        lanes, [&](int m, int n, Vector sum) __attribute__((always_inline)) {
          const Vector logit = Simd::subtract(sum, Simd::broadcast(lse[first + m]));
          const Vector p = first + m < count ? UnitSimd::exp2(logit) : Simd::zero();
          Simd::store(probabilities + m * lanes + n * Simd::lanes, p);
        });
    Unit::template multiply<OperandKind::kBFloat16>(
        depth, gradients + first * tile.head_words, tile.head_words, words_at(scratch.values),
        lanes, [&](int m, int n, Vector sum) __attribute__((always_inline)) {
          const int64_t place = m * lanes + n * Simd::lanes;
          Simd::store(logit_gradients + place,
                      Simd::multiply(Simd::load(probabilities + place),
                                     Simd::subtract(sum, Simd::broadcast(dot[first + m]))));
        });
  }
  if (keys < lanes) {
    for (int64_t row = 0; row < count; ++row) {
      for (int64_t lane = keys; lane < lanes; ++lane) {
        scratch.probabilities[row * lanes + lane] = scratch.logit_gradients[row * lanes + lane] = 0;
      }
    }
  }
  auto* rows = reinterpret_cast<uint16_t*>(scratch.logit_gradient_rows);
  // The rows come in whole strips, which are multiplied as such.
  for (int64_t w = 0; w < round_up(2 * words, Unit::rows) / 2; ++w) {
#pragma GCC unroll 8
    for (int n = 0; n < Unit::vectors; ++n) {
      const int64_t even = 2 * w * lanes + n * Simd::lanes, odd = even + lanes;
      const int64_t place = w * lanes + n * Simd::lanes;
      const Vector first = Simd::load(scratch.logit_gradients + even),
                   second = Simd::load(scratch.logit_gradients + odd);
      UnitSimd::store_pairs(words_at(scratch.probability_pairs) + place,
                            Simd::load(scratch.probabilities + even),
                            Simd::load(scratch.probabilities + odd));
      UnitSimd::store_pairs(words_at(scratch.logit_gradient_pairs) + place, first, second);
      UnitSimd::store_bfloat16(rows + even, first);
      UnitSimd::store_bfloat16(rows + odd, second);
    }
  }
  return words;
}

// sums (head_rows, lanes) += channels (head_rows, kBlockPairs) pairs (words, lanes).
template <class Unit>
GLD_INLINE void add_channel_products(int64_t head_dim, int64_t words, const uint32_t* channels,
                                     const uint32_t* pairs, float* sums) {
  constexpr int64_t lanes = Unit::lanes;
  for (int64_t channel = 0; channel < head_dim; channel += Unit::rows) {
    float* rows = sums + channel * lanes;
    Unit::template multiply<OperandKind::kBFloat16>(
        words, channels + channel * kBlockPairs, kBlockPairs, pairs,
        lanes, [&](int m, int n, Vector sum) __attribute__((always_inline)) {
          float* place = rows + m * lanes + n * Simd::lanes;
          Simd::store(place, Simd::add(Simd::load(place), sum));
        });
  }
}

template <class Unit>
GLD_INLINE void unit_backward_step(const UnitAttentionBackwardTile& tile, int64_t block, int64_t keys,
                                   const UnitBackwardScratch<Unit>& scratch) {
  constexpr int64_t lanes = Unit::lanes, pair_words = lanes / 2;
  const int64_t words = unit_logit_gradients<Unit>(tile, block, keys, scratch);
  const int64_t channels = block * kBlockPairs * tile.head_rows;
  add_channel_products<Unit>(tile.head_dim, words, tile.query_channels + channels,
                             words_at(scratch.logit_gradient_pairs), scratch.key_sums);
  add_channel_products<Unit>(tile.head_dim, words, tile.output_gradient_channels + channels,
                             words_at(scratch.probability_pairs), scratch.value_sums);
  float* gradients = tile.query_gradients + block * kBlockTokens * tile.query_gradient_stride;
  const int64_t count = tile.block_queries[block];
  for (int64_t first = 0; first < count; first += Unit::rows) {
    float* rows = gradients + first * tile.query_gradient_stride;
    for (int64_t panel = 0; panel * lanes < tile.head_dim; ++panel) {
      Unit::template multiply<OperandKind::kBFloat16>(
          pair_words, words_at(scratch.logit_gradient_rows) + first * pair_words, pair_words,
          words_at(scratch.key_pairs) + panel * pair_words * lanes,
          lanes, [&](int m, int n, Vector sum) __attribute__((always_inline)) {
            float* place = rows + m * tile.query_gradient_stride + panel * lanes + n * Simd::lanes;
            Simd::store(place, Simd::add(Simd::load(place), sum));
          });
    }
  }
}

// Does what attention_backward_tile of attention_tiles.h does, on the unit.
template <class Unit>
void unit_attention_backward(const UnitAttentionBackwardTile& tile) {
  [[maybe_unused]] const typename Unit::Session session;
  constexpr int64_t lanes = Unit::lanes;
  const int64_t groups = round_up(tile.key_count, lanes) / lanes;
  const auto scratch_of = [&](int64_t g) {
    return UnitBackwardScratch<Unit>(tile.scratch, g, tile.head_words, tile.head_rows);
  };
  const auto group_keys = [&](int64_t g) {
    const int64_t left = tile.key_count - g * lanes;
    return left < lanes ? left : lanes;
  };
  for (int64_t g = 0; g < groups; ++g) {
    const auto scratch = scratch_of(g);
    const int64_t first = g * lanes * tile.head_words;
    transpose_words<Unit>(tile.keys + first, group_keys(g), tile.head_words, scratch.keys);
    transpose_words<Unit>(tile.values + first, group_keys(g), tile.head_words, scratch.values);
    pair_keys<Unit>(tile, tile.keys + first, group_keys(g), words_at(scratch.key_pairs));
    for (int64_t i = 0; i < 2 * tile.head_rows * lanes; ++i) scratch.key_sums[i] = 0;
  }
  for (int64_t block = 0; block < tile.blocks; ++block) {
    for (int64_t g = 0; g < groups; ++g) {
      unit_backward_step<Unit>(tile, block, group_keys(g), scratch_of(g));
    }
  }
  for (int64_t g = 0; g < groups; ++g) {
    const auto scratch = scratch_of(g);
    float* ones = scratch.probabilities;
    for (int64_t lane = 0; lane < lanes; ++lane) ones[lane] = 1;
    const int64_t first = g * lanes * tile.gradient_stride;
    transpose_back<Unit::lanes>(scratch.key_sums, ones, group_keys(g), tile.gradient_stride, tile.head_dim,
                                tile.key_gradients + first);
    transpose_back<Unit::lanes>(scratch.value_sums, ones, group_keys(g), tile.gradient_stride, tile.head_dim,
                                tile.value_gradients + first);
  }
}

}  // namespace
}  // namespace gld
