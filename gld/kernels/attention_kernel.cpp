#include "gld/kernels/attention_kernel.h"

#include "gld/kernels/aligned_floats.h"
#include "gld/kernels/attention_rows.h"
#include "gld/kernels/kernel_table.h"
#include "gld/kernels/product_shares.h"
#include "gld/kernels/unit_attention.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <omp.h>

namespace gld {
namespace {

// Packed keys and values of as many heads as fit here are prepared at once.
constexpr int64_t kPackedFloats = 32 * 1024 * 1024 / sizeof(float);
constexpr int64_t kPackRows = 64;

// Rows hold whole 16-float lines, an odd number of them: an even number would put the same channel of all rows into a
// fraction of the cache's sets.
int64_t packed_stride(int64_t head_dim) {
  const int64_t lines = rounded_up(head_dim, 16) / 16;
  return 16 * (lines % 2 == 0 ? lines + 1 : lines);
}

struct ForwardPlan {
  int64_t stride;           // of packed rows
  int64_t padded_head_dim;  // what the kernels compute with
  int64_t head_floats;      // one packed matrix of keys or values
  int64_t heads_at_once;
  int64_t tile_queries;
  int64_t thread_floats;  // queries, output, log-sum-exp and the kernel's own scratch
};

ForwardPlan plan_forward(const AttentionForward& arrays, const KernelTable& kernels, int threads) {
  ForwardPlan plan = {};
  plan.stride = packed_stride(arrays.shape.head_dim);
  plan.padded_head_dim = rounded_up(arrays.shape.head_dim, 8);
  plan.head_floats = (arrays.shape.keys + kPackedRowPadding) * plan.stride;
  const int64_t heads = arrays.shape.batch * arrays.shape.heads;
  plan.heads_at_once =
      std::clamp<int64_t>(kPackedFloats / (2 * plan.head_floats), 1, std::max<int64_t>(heads, 1));
  // Large tiles read keys and values less often, but every thread should get many tiles.
  const int64_t share = arrays.shape.queries * heads / (kTilesAThread * threads);
  plan.tile_queries = std::clamp(share / kernels.tile_lanes * kernels.tile_lanes, kernels.tile_lanes,
                                 kernels.forward_queries);
  plan.thread_floats = rounded_up(kernels.forward_scratch(plan.padded_head_dim), 16) +
                       2 * plan.tile_queries * plan.stride + rounded_up(plan.tile_queries, 16);
  return plan;
}

// Packs keys and values of some tokens (and the zero rows behind the last one) of one batch entry, for those of its
// heads that lie in the range. Heads run innermost because they lie next to each other in a token.
void pack_keys_and_values(const AttentionForward& arrays, const Encoder& encoder, const ForwardPlan& plan,
                          const HeadRange& range, int64_t batch, const TokenRange& tokens, float* packed) {
  const AttentionShape& shape = arrays.shape;
  const int64_t begin = std::max(range.first, batch * shape.heads);
  const int64_t end = std::min(range.first + range.count, (batch + 1) * shape.heads);
  const int64_t last_token = std::min(tokens.first + tokens.count, shape.keys + kPackedRowPadding);
  for (int64_t token = tokens.first; token < last_token; ++token) {
    for (int64_t index = begin; index < end; ++index) {
      float* key = packed + 2 * (index - range.first) * plan.head_floats + token * plan.stride;
      float* value = key + plan.head_floats;
      const int64_t head = index % shape.heads;
      if (token < shape.keys) {
        encoder.apply(Encoding::key_value, token, 1.0f, row_of(arrays.key, batch, head, token), key);
        encoder.apply(Encoding::key_value, token, 1.0f, row_of(arrays.value, batch, head, token), value);
      }
      const int64_t used = token < shape.keys ? shape.head_dim : 0;
      clear_tail(key, used, plan.stride);
      clear_tail(value, used, plan.stride);
    }
  }
}

}  // namespace

double attention_forward_flops(const AttentionShape& shape) {
  return 4.0 * static_cast<double>(shape.batch * shape.heads) * static_cast<double>(shape.queries) *
         static_cast<double>(shape.keys) * static_cast<double>(shape.head_dim);
}

double attention_backward_flops(const AttentionShape& shape) { return 2.5 * attention_forward_flops(shape); }

int64_t attention_forward_scratch_bytes(const AttentionForward& arrays, const KernelSettings& settings) {
  check_attention(arrays, settings);
  if (settings.precision != ComputePrecision::kFloat32) return unit_attention_scratch_bytes(arrays, settings);
  const ForwardPlan plan = plan_forward(arrays, kernel_table(settings.instruction_set), settings.threads);
  return static_cast<int64_t>(sizeof(float)) *
         (2 * plan.heads_at_once * plan.head_floats + settings.threads * plan.thread_floats);
}

void attention_forward(const AttentionForward& arrays, const KernelSettings& settings) {
  check_attention(arrays, settings);
  if (settings.precision != ComputePrecision::kFloat32) {
    unit_attention_forward(arrays, settings);
    return;
  }
  const KernelTable& kernels = kernel_table(settings.instruction_set);
  const AttentionShape& shape = arrays.shape;
  const ForwardPlan plan = plan_forward(arrays, kernels, settings.threads);
  const Encoder encoder(arrays, kernels);
  const auto query_tiles = tiles(shape.queries, plan.tile_queries);
  const auto num_tiles = static_cast<int64_t>(query_tiles.size());
  const int64_t row_chunks = (shape.keys + kPackedRowPadding + kPackRows - 1) / kPackRows;
  const float factor = query_factor(shape.head_dim);

  const AlignedFloats packed(2 * plan.heads_at_once * plan.head_floats);
  const AlignedFloats scratch(settings.threads * plan.thread_floats);
  const int64_t all_heads = shape.batch * shape.heads;
  for (int64_t first_head = 0; first_head < all_heads; first_head += plan.heads_at_once) {
    const int64_t heads = std::min(plan.heads_at_once, all_heads - first_head);
    const int64_t first_batch = first_head / shape.heads;
    const int64_t batches = (first_head + heads - 1) / shape.heads - first_batch + 1;
#pragma omp parallel num_threads(settings.threads)
    {
#pragma omp for schedule(static)
      for (int64_t item = 0; item < batches * row_chunks; ++item) {
        const int64_t batch = first_batch + item / row_chunks;
        const TokenRange tokens = {item % row_chunks * kPackRows, kPackRows};
        pack_keys_and_values(arrays, encoder, plan, {first_head, heads}, batch, tokens, packed.data());
      }

      float* queries = scratch.data() + omp_get_thread_num() * plan.thread_floats;
      float* outputs = queries + plan.tile_queries * plan.stride;
      float* base2_lse = outputs + plan.tile_queries * plan.stride;
#pragma omp for schedule(dynamic, 1)
      for (int64_t item = 0; item < heads * num_tiles; ++item) {
        const int64_t head = item / num_tiles;
        const int64_t batch = (first_head + head) / shape.heads;
        const int64_t head_in_batch = (first_head + head) % shape.heads;
        const TokenRange& tile = query_tiles[static_cast<std::size_t>(item % num_tiles)];
        for (int64_t i = 0; i < tile.count; ++i) {
          const int64_t token = tile.first + i;
          float* row = queries + i * plan.stride;
          const float* from = row_of(arrays.query, batch, head_in_batch, token);
          prefetch_row(from + kPrefetchRows * arrays.query.token_stride, shape.head_dim);
          encoder.apply(Encoding::query, token, factor, from, row);
          clear_tail(row, shape.head_dim, plan.stride);
        }
        AttentionForwardTile kernel_tile = {};
        kernel_tile.queries = queries;
        kernel_tile.query_count = tile.count;
        kernel_tile.keys = packed.data() + 2 * head * plan.head_floats;
        kernel_tile.values = kernel_tile.keys + plan.head_floats;
        kernel_tile.stride = plan.stride;
        kernel_tile.head_dim = plan.padded_head_dim;
        kernel_tile.key_count = shape.keys;
        kernel_tile.scratch = base2_lse + rounded_up(plan.tile_queries, 16);
        kernel_tile.output = outputs;
        kernel_tile.base2_lse = base2_lse;
        kernels.attention_forward(kernel_tile);
        for (int64_t i = 0; i < tile.count; ++i) {
          const int64_t token = tile.first + i;
          float* to = row_of(arrays.output, batch, head_in_batch, token);
          prefetch_row(to + kPrefetchRows * arrays.output.token_stride, shape.head_dim);
          encoder.apply(Encoding::output, token, 1.0f, outputs + i * plan.stride, to);
          if (arrays.log_sum_exp != nullptr) {
            arrays.log_sum_exp[(first_head + head) * shape.queries + token] =
                static_cast<float>(kLn2 * static_cast<double>(base2_lse[i]));
          }
        }
      }
    }
  }
}

void attention_backward(const AttentionBackward& arrays, const KernelSettings& settings) {
  const AttentionForward& forward = arrays.forward;
  check_attention(forward, settings);
  if (settings.precision != ComputePrecision::kFloat32) {
    unit_attention_backward(arrays, settings);
    return;
  }
  const KernelTable& kernels = kernel_table(settings.instruction_set);
  const AttentionShape& shape = forward.shape;
  const Encoder encoder(forward, kernels);
  const int64_t stride = packed_stride(shape.head_dim);
  const int64_t padded_head_dim = rounded_up(shape.head_dim, 8);
  // Large tiles read queries less often, but the tiles of one head are shared between the threads.
  const int64_t share = shape.keys / (kBackwardTilesAThread * settings.threads);
  const int64_t tile_keys =
      std::clamp(share / kernels.tile_lanes * kernels.tile_lanes, kernels.tile_lanes, kernels.backward_keys);
  const auto key_tiles = tiles(shape.keys, tile_keys);
  const auto num_tiles = static_cast<int64_t>(key_tiles.size());
  const double scale = 1.0 / std::sqrt(static_cast<double>(shape.head_dim));
  const float factor = query_factor(shape.head_dim);

  const int64_t query_floats = (shape.queries + kPackedRowPadding) * stride;
  const int64_t key_floats = (shape.keys + kPackedRowPadding) * stride;
  const int64_t thread_floats = query_floats + 2 * tile_keys * stride + stride +
                                rounded_up(kernels.backward_scratch(padded_head_dim), 16);
  const AlignedFloats packed(2 * query_floats + 2 * key_floats + 2 * shape.queries);
  const AlignedFloats scratch(settings.threads * thread_floats);
  float* queries = packed.data();
  float* output_gradients = queries + query_floats;
  float* keys = output_gradients + query_floats;
  float* values = keys + key_floats;
  float* base2_lse = values + key_floats;
  float* output_dot = base2_lse + shape.queries;

  for (int64_t index = 0; index < shape.batch * shape.heads; ++index) {
    const int64_t batch = index / shape.heads;
    const int64_t head = index % shape.heads;
#pragma omp parallel num_threads(settings.threads)
    {
      float* query_gradients = scratch.data() + omp_get_thread_num() * thread_floats;
      float* key_gradients = query_gradients + query_floats;
      float* value_gradients = key_gradients + tile_keys * stride;
      float* row_scratch = value_gradients + tile_keys * stride;
      std::fill(query_gradients, query_gradients + query_floats, 0.0f);
#pragma omp for schedule(static) nowait
      for (int64_t token = 0; token < shape.queries + kPackedRowPadding; ++token) {
        float* query = queries + token * stride;
        float* gradient = output_gradients + token * stride;
        const bool padding = token >= shape.queries;
        if (!padding) {
          const float* from = row_of(arrays.output_gradient, batch, head, token);
          const float* output = row_of(forward.output, batch, head, token);
          encoder.apply(Encoding::query, token, factor, row_of(forward.query, batch, head, token), query);
          encoder.apply_transposed(Encoding::output, token, 1.0f, from, gradient);
          double dot = 0;
          for (int64_t c = 0; c < shape.head_dim; ++c) {
            dot += static_cast<double>(from[c]) * static_cast<double>(output[c]);
          }
          output_dot[token] = static_cast<float>(dot);
          base2_lse[token] = static_cast<float>(
              kLog2E * static_cast<double>(forward.log_sum_exp[index * shape.queries + token]));
        }
        clear_tail(query, padding ? 0 : shape.head_dim, stride);
        clear_tail(gradient, padding ? 0 : shape.head_dim, stride);
      }
#pragma omp for schedule(static)
      for (int64_t token = 0; token < shape.keys + kPackedRowPadding; ++token) {
        float* key = keys + token * stride;
        float* value = values + token * stride;
        const bool padding = token >= shape.keys;
        if (!padding) {
          encoder.apply(Encoding::key_value, token, 1.0f, row_of(forward.key, batch, head, token), key);
          encoder.apply(Encoding::key_value, token, 1.0f, row_of(forward.value, batch, head, token), value);
        }
        clear_tail(key, padding ? 0 : shape.head_dim, stride);
        clear_tail(value, padding ? 0 : shape.head_dim, stride);
      }

      // A fixed assignment of tiles to threads keeps the order of every sum.
#pragma omp for schedule(static, 1)
      for (int64_t item = 0; item < num_tiles; ++item) {
        const TokenRange& tile = key_tiles[static_cast<std::size_t>(item)];
        AttentionBackwardTile kernel_tile = {};
        kernel_tile.queries = queries;
        kernel_tile.output_gradients = output_gradients;
        kernel_tile.base2_lse = base2_lse;
        kernel_tile.output_dot = output_dot;
        kernel_tile.keys = keys + tile.first * stride;
        kernel_tile.values = values + tile.first * stride;
        kernel_tile.key_count = tile.count;
        kernel_tile.stride = stride;
        kernel_tile.head_dim = padded_head_dim;
        kernel_tile.query_count = shape.queries;
        kernel_tile.scratch = row_scratch + stride;
        kernel_tile.query_gradients = query_gradients;
        kernel_tile.key_gradients = key_gradients;
        kernel_tile.value_gradients = value_gradients;
        kernels.attention_backward(kernel_tile);
        for (int64_t i = 0; i < tile.count; ++i) {
          const int64_t token = tile.first + i;
          // The packed queries carry log2(e) / sqrt(head_dim); the logits' gradient wants 1 / sqrt(head_dim).
          encoder.apply_transposed(Encoding::key_value, token, static_cast<float>(kLn2),
                                   key_gradients + i * stride,
                                   row_of(arrays.key_gradient, batch, head, token));
          encoder.apply_transposed(Encoding::key_value, token, 1.0f, value_gradients + i * stride,
                                   row_of(arrays.value_gradient, batch, head, token));
        }
      }

      const int team = omp_get_num_threads();
#pragma omp for schedule(static)
      for (int64_t token = 0; token < shape.queries; ++token) {
        std::copy_n(scratch.data() + token * stride, shape.head_dim, row_scratch);
        for (int thread = 1; thread < team; ++thread) {
          const float* part = scratch.data() + thread * thread_floats + token * stride;
          for (int64_t c = 0; c < shape.head_dim; ++c) row_scratch[c] += part[c];
        }
        encoder.apply_transposed(Encoding::query, token, static_cast<float>(scale), row_scratch,
                                 row_of(arrays.query_gradient, batch, head, token));
      }
    }
  }
}

}  // namespace gld
