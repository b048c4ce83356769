#include "gld/kernels/aligned_floats.h"
#include "gld/kernels/product_shares.h"
#include "gld/kernels/unit_attention.h"
#include "gld/kernels/unit_attention_blocks.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <omp.h>

namespace gld {
namespace {

class UnitAttentionBackward {
 public:
  UnitAttentionBackward(const AttentionBackward& arrays, const KernelSettings& settings)
      : arrays_(arrays),
        forward_(arrays.forward),
        shape_(arrays.forward.shape),
        unit_(attention_unit(settings)),
        encoder_(arrays.forward, kernel_table(settings.instruction_set)),
        head_(shape_.head_dim, unit_),
        blocks_(token_blocks(shape_.queries)),
        threads_(settings.threads),
        gradient_stride_(rounded_up(head_.head_dim, unit_.lanes)),
        query_floats_(blocks_.count() * kBlockTokens * gradient_stride_) {
    // Large tiles read queries less often, but the tiles of one head are shared between the threads.
    const int64_t share = shape_.keys / (kBackwardTilesAThread * threads_);
    tile_keys_ = std::clamp(share / unit_.lanes * unit_.lanes, unit_.lanes, unit_.backward_keys);
    places_ = thread_scratch();
  }

  void run() const {
    const auto key_tiles = tiles(shape_.keys, tile_keys_);
    Packed packed(*this);
    const int64_t thread_floats = places_.floats;
    const AlignedFloats scratch(threads_ * thread_floats);
    for (int64_t index = 0; index < shape_.batch * shape_.heads; ++index) {
#pragma omp parallel num_threads(threads_)
      {
        float* own = scratch.data() + omp_get_thread_num() * thread_floats;
        std::fill(own, own + query_floats_, 0.0f);
#pragma omp for schedule(static) nowait
        for (int64_t block = 0; block < blocks_.count(); ++block) pack_block(index, block, own, packed);
#pragma omp for schedule(static)
        for (int64_t token = 0; token < shape_.keys; ++token) {
          pack_key(index, token, own, packed);
        }
        // A fixed assignment of tiles to threads keeps the order of every sum.
#pragma omp for schedule(static, 1)
        for (int64_t item = 0; item < static_cast<int64_t>(key_tiles.size()); ++item) {
          const TokenRange& tile = key_tiles[static_cast<std::size_t>(item)];
          add_tile(index, tile, packed, own);
        }
        const int team = omp_get_num_threads();
#pragma omp for schedule(static)
        for (int64_t block = 0; block < blocks_.count(); ++block) {
          sum_query_gradients(index, block, scratch.data(), team);
        }
      }
    }
  }

 private:
  // One head's tokens: queries and gradients of the output as rows and as channels, keys and values as rows.
  struct Packed {
    explicit Packed(const UnitAttentionBackward& of)
        : rows(of.blocks_.count() * of.head_.block_rows()),
          channels(of.blocks_.count() * of.head_.block_channels()),
          key_rows(of.shape_.keys * of.head_.head_words),
          table(of.blocks_.count() * kBlockTokens),
          memory(2 * rows + 2 * channels + 2 * key_rows + 2 * table) {
      queries = reinterpret_cast<uint32_t*>(memory.data());
      output_gradients = queries + rows;
      query_channels = output_gradients + rows;
      output_gradient_channels = query_channels + channels;
      keys = output_gradient_channels + channels;
      values = keys + key_rows;
      base2_lse = memory.data() + 2 * (rows + channels + key_rows);
      output_dot = base2_lse + table;
    }

    int64_t rows, channels, key_rows, table;
    AlignedFloats memory;
    uint32_t *queries, *output_gradients, *query_channels, *output_gradient_channels, *keys, *values;
    float *base2_lse, *output_dot;
  };

  // A thread's: gradients of all queries, of the keys and values of a tile, a row, and the kernel's own.
  struct ThreadScratch {
    int64_t key_gradients, value_gradients, row, kernel, floats;
  };

  ThreadScratch thread_scratch() const {
    ThreadScratch scratch = {};
    scratch.key_gradients = query_floats_;
    scratch.value_gradients = scratch.key_gradients + tile_keys_ * gradient_stride_;
    scratch.row = scratch.value_gradients + tile_keys_ * gradient_stride_;
    scratch.kernel = rounded_up(scratch.row + gradient_stride_, 16);
    scratch.floats =
        rounded_up(scratch.kernel + unit_.backward_scratch(head_.head_words, head_.head_rows), 16);
    return scratch;
  }

  void to_row(const float* row, uint32_t* words) const {
    unit_.to_bfloat16(row, head_.head_dim, 2 * head_.head_words, halves(words));
  }

  // Returns a row of the scratch whose channels past the head's are zero.
  float* empty_row(float* own) const {
    float* row = own + places_.row;
    std::fill(row, row + head_.head_dim, 0.0f);
    return row;
  }

  void pack_block(int64_t index, int64_t block, float* own, const Packed& packed) const {
    const int64_t batch = index / shape_.heads, head = index % shape_.heads;
    const TokenRange& tokens = blocks_.tokens[static_cast<std::size_t>(block)];
    uint32_t* queries = packed.queries + block * head_.block_rows();
    uint32_t* gradients = packed.output_gradients + block * head_.block_rows();
    float* lse = packed.base2_lse + block * kBlockTokens;
    float* output_dot = packed.output_dot + block * kBlockTokens;
    const float factor = query_factor(shape_.head_dim);
    float* row = empty_row(own);
    for (int64_t i = 0; i < tokens.count; ++i) {
      const int64_t token = tokens.first + i;
      const float* from = row_of(arrays_.output_gradient, batch, head, token);
      const float* output = row_of(forward_.output, batch, head, token);
      encoder_.apply(Encoding::query, token, factor, row_of(forward_.query, batch, head, token), row);
      to_row(row, queries + i * head_.head_words);
      encoder_.apply_transposed(Encoding::output, token, 1.0f, from, row);
      to_row(row, gradients + i * head_.head_words);
      double dot = 0;
      for (int64_t c = 0; c < shape_.head_dim; ++c) {
        dot += static_cast<double>(from[c]) * static_cast<double>(output[c]);
      }
      output_dot[i] = static_cast<float>(dot);
      lse[i] = static_cast<float>(kLog2E *
                                  static_cast<double>(forward_.log_sum_exp[index * shape_.queries + token]));
    }
    for (uint32_t* rows : {queries, gradients}) {
      std::fill(halves(rows) + 2 * tokens.count * head_.head_words, halves(rows) + 2 * head_.block_rows(),
                uint16_t{0});
    }
    std::fill(lse + tokens.count, lse + kBlockTokens, 0.0f);
    std::fill(output_dot + tokens.count, output_dot + kBlockTokens, 0.0f);
    const int64_t channels = block * head_.block_channels();
    pack_channels(head_, halves(queries), 2 * head_.head_words, packed.query_channels + channels);
    pack_channels(head_, halves(gradients), 2 * head_.head_words, packed.output_gradient_channels + channels);
  }

  void pack_key(int64_t index, int64_t token, float* own, const Packed& packed) const {
    const int64_t batch = index / shape_.heads, head = index % shape_.heads;
    float* row = empty_row(own);
    encoder_.apply(Encoding::key_value, token, 1.0f, row_of(forward_.key, batch, head, token), row);
    to_row(row, packed.keys + token * head_.head_words);
    encoder_.apply(Encoding::key_value, token, 1.0f, row_of(forward_.value, batch, head, token), row);
    to_row(row, packed.values + token * head_.head_words);
  }

  void add_tile(int64_t index, const TokenRange& tile, const Packed& packed, float* own) const {
    const int64_t batch = index / shape_.heads, head = index % shape_.heads;
    UnitAttentionBackwardTile kernel_tile = {};
    kernel_tile.queries = packed.queries;
    kernel_tile.query_channels = packed.query_channels;
    kernel_tile.output_gradients = packed.output_gradients;
    kernel_tile.output_gradient_channels = packed.output_gradient_channels;
    kernel_tile.block_queries = blocks_.counts.data();
    kernel_tile.base2_lse = packed.base2_lse;
    kernel_tile.output_dot = packed.output_dot;
    kernel_tile.keys = packed.keys + tile.first * head_.head_words;
    kernel_tile.values = packed.values + tile.first * head_.head_words;
    kernel_tile.key_count = tile.count;
    kernel_tile.head_words = head_.head_words;
    kernel_tile.head_rows = head_.head_rows;
    kernel_tile.head_dim = head_.head_dim;
    kernel_tile.blocks = blocks_.count();
    kernel_tile.scratch = own + places_.kernel;
    kernel_tile.query_gradients = own;
    kernel_tile.query_gradient_stride = gradient_stride_;
    kernel_tile.key_gradients = own + places_.key_gradients;
    kernel_tile.value_gradients = own + places_.value_gradients;
    kernel_tile.gradient_stride = gradient_stride_;
    unit_.attention_backward(kernel_tile);
    for (int64_t i = 0; i < tile.count; ++i) {
      const int64_t token = tile.first + i;
      // The packed queries carry log2(e) / sqrt(head_dim); the logits' gradient wants 1 / sqrt(head_dim).
      encoder_.apply_transposed(Encoding::key_value, token, static_cast<float>(kLn2),
                                kernel_tile.key_gradients + i * gradient_stride_,
                                row_of(arrays_.key_gradient, batch, head, token));
      encoder_.apply_transposed(Encoding::key_value, token, 1.0f,
                                kernel_tile.value_gradients + i * gradient_stride_,
                                row_of(arrays_.value_gradient, batch, head, token));
    }
  }

  void sum_query_gradients(int64_t index, int64_t block, float* scratch, int team) const {
    const int64_t batch = index / shape_.heads, head = index % shape_.heads;
    const auto factor = static_cast<float>(1.0 / std::sqrt(static_cast<double>(shape_.head_dim)));
    float* row = scratch + omp_get_thread_num() * places_.floats + places_.row;
    const TokenRange& tokens = blocks_.tokens[static_cast<std::size_t>(block)];
    for (int64_t i = 0; i < tokens.count; ++i) {
      const int64_t place = (block * kBlockTokens + i) * gradient_stride_;
      std::copy_n(scratch + place, shape_.head_dim, row);
      for (int thread = 1; thread < team; ++thread) {
        const float* part = scratch + thread * places_.floats + place;
        for (int64_t c = 0; c < shape_.head_dim; ++c) row[c] += part[c];
      }
      const int64_t token = tokens.first + i;
      encoder_.apply_transposed(Encoding::query, token, factor, row,
                                row_of(arrays_.query_gradient, batch, head, token));
    }
  }

  const AttentionBackward& arrays_;
  const AttentionForward& forward_;
  const AttentionShape& shape_;
  const MatrixUnitKernels& unit_;
  Encoder encoder_;
  UnitHead head_;
  TokenBlocks blocks_;
  int threads_;
  int64_t gradient_stride_;
  int64_t query_floats_;
  int64_t tile_keys_ = 0;
  ThreadScratch places_ = {};
};

}  // namespace

void unit_attention_backward(const AttentionBackward& arrays, const KernelSettings& settings) {
  UnitAttentionBackward(arrays, settings).run();
}

}  // namespace gld
