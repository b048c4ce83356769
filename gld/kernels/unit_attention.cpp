#include "gld/kernels/unit_attention.h"

#include "gld/kernels/aligned_floats.h"
#include "gld/kernels/product_shares.h"
#include "gld/kernels/unit_attention_blocks.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <omp.h>

namespace gld {
namespace {

// Packed keys and values of as many heads as fit here are prepared at once.
constexpr int64_t kPackedWords = 16 * 1024 * 1024 / sizeof(uint32_t);

struct UnitAttentionPlan {
  UnitHead head;
  int64_t key_words;    // all keys of one head
  int64_t head_packed;  // keys and values of one head, words
  int64_t heads_at_once;
  int64_t tile_queries;
  int64_t thread_floats;
};

UnitAttentionPlan unit_attention_plan(const AttentionForward& arrays, const TokenBlocks& blocks,
                                      const MatrixUnitKernels& unit, int threads) {
  const AttentionShape& shape = arrays.shape;
  UnitAttentionPlan plan = {UnitHead(shape.head_dim, unit), 0, 0, 0, 0, 0};
  plan.key_words = blocks.count() * plan.head.block_rows();
  plan.head_packed = plan.key_words + blocks.count() * plan.head.block_channels();
  const int64_t heads = shape.batch * shape.heads;
  plan.heads_at_once = std::clamp<int64_t>(kPackedWords / std::max<int64_t>(plan.head_packed, 1), 1,
                                           std::max<int64_t>(heads, 1));
  // Large tiles read keys and values less often, but every thread should get many tiles.
  const int64_t share = shape.queries * heads / (kTilesAThread * threads);
  plan.tile_queries = std::clamp(share / unit.lanes * unit.lanes, unit.lanes, unit.forward_queries);
  const int64_t encoding =
      2 * rounded_up(kBlockTokens * plan.head.head_dim, 16);  // floats of a block, and bfloat16
  const int64_t tile = plan.tile_queries * (plan.head.head_words + plan.head.head_dim) +
                       rounded_up(plan.tile_queries, 16) +
                       unit.forward_scratch(plan.head.head_words, plan.head.head_rows);
  plan.thread_floats = rounded_up(std::max(encoding, tile + plan.head.head_dim), 16);
  return plan;
}

class UnitAttention {
 public:
  UnitAttention(const AttentionForward& arrays, const KernelSettings& settings)
      : arrays_(arrays),
        shape_(arrays.shape),
        unit_(attention_unit(settings)),
        encoder_(arrays, kernel_table(settings.instruction_set)),
        blocks_(token_blocks(arrays.shape.keys)),
        plan_(unit_attention_plan(arrays, blocks_, unit_, settings.threads)),
        threads_(settings.threads) {}

  int64_t scratch_bytes() const {
    return static_cast<int64_t>(sizeof(float)) *
           (plan_.heads_at_once * plan_.head_packed + threads_ * plan_.thread_floats);
  }

  void run() const {
    const auto query_tiles = tiles(shape_.queries, plan_.tile_queries);
    const auto num_tiles = static_cast<int64_t>(query_tiles.size());
    const AlignedFloats packed(plan_.heads_at_once * plan_.head_packed);
    const AlignedFloats scratch(threads_ * plan_.thread_floats);
    auto* words = reinterpret_cast<uint32_t*>(packed.data());
    const int64_t all_heads = shape_.batch * shape_.heads;
    for (int64_t first_head = 0; first_head < all_heads; first_head += plan_.heads_at_once) {
      const HeadRange heads = {first_head, std::min(plan_.heads_at_once, all_heads - first_head)};
#pragma omp parallel num_threads(threads_)
      {
        float* own = scratch.data() + omp_get_thread_num() * plan_.thread_floats;
        // Heads run innermost because they lie next to each other in a token.
#pragma omp for schedule(static)
        for (int64_t item = 0; item < blocks_.count() * heads.count; ++item) {
          const int64_t head = item % heads.count;
          pack_block(item / heads.count, heads.first + head, own, words + head * plan_.head_packed);
        }
#pragma omp for schedule(dynamic, 1)
        for (int64_t item = 0; item < heads.count * num_tiles; ++item) {
          const int64_t head = item / num_tiles;
          const TokenRange& tile = query_tiles[static_cast<std::size_t>(item % num_tiles)];
          attend(heads.first + head, tile, words + head * plan_.head_packed, own);
        }
      }
    }
  }

 private:
  void pack_block(int64_t block, int64_t index, float* own, uint32_t* packed) const {
    const int64_t batch = index / shape_.heads, head = index % shape_.heads;
    const TokenRange& tokens = blocks_.tokens[static_cast<std::size_t>(block)];
    const int64_t dim = plan_.head.head_dim;
    uint32_t* keys = packed + block * plan_.head.block_rows();
    uint32_t* values = packed + plan_.key_words + block * plan_.head.block_channels();
    float* row = own;
    auto* value_rows = reinterpret_cast<uint16_t*>(own + rounded_up(kBlockTokens * dim, 16));
    std::fill(row, row + dim, 0.0f);
    for (int64_t i = 0; i < kBlockTokens; ++i) {
      uint16_t* key = halves(keys + i * plan_.head.head_words);
      uint16_t* value = value_rows + i * dim;
      if (i >= tokens.count) {
        std::fill_n(key, 2 * plan_.head.head_words, uint16_t{0});
        std::fill_n(value, dim, uint16_t{0});
        continue;
      }
      const int64_t token = tokens.first + i;
      encoder_.apply(Encoding::key_value, token, 1.0f, row_of(arrays_.key, batch, head, token), row);
      unit_.to_bfloat16(row, dim, 2 * plan_.head.head_words, key);
      encoder_.apply(Encoding::key_value, token, 1.0f, row_of(arrays_.value, batch, head, token), row);
      unit_.to_bfloat16(row, dim, dim, value);
    }
    pack_channels(plan_.head, value_rows, dim, values);
  }

  void attend(int64_t index, const TokenRange& tile, const uint32_t* packed, float* own) const {
    const int64_t batch = index / shape_.heads, head = index % shape_.heads, dim = plan_.head.head_dim;
    const float factor = query_factor(shape_.head_dim);
    float* scratch = own;
    auto* queries = reinterpret_cast<uint32_t*>(
        scratch + unit_.forward_scratch(plan_.head.head_words, plan_.head.head_rows));
    float* outputs = reinterpret_cast<float*>(queries) + plan_.tile_queries * plan_.head.head_words;
    float* base2_lse = outputs + plan_.tile_queries * dim;
    float* row = base2_lse + rounded_up(plan_.tile_queries, 16);
    std::fill(row, row + dim, 0.0f);
    for (int64_t i = 0; i < tile.count; ++i) {
      const int64_t token = tile.first + i;
      const float* from = row_of(arrays_.query, batch, head, token);
      prefetch_row(from + kPrefetchRows * arrays_.query.token_stride, shape_.head_dim);
      encoder_.apply(Encoding::query, token, factor, from, row);
      unit_.to_bfloat16(row, dim, 2 * plan_.head.head_words, halves(queries + i * plan_.head.head_words));
    }
    UnitAttentionTile kernel_tile = {};
    kernel_tile.queries = queries;
    kernel_tile.query_count = tile.count;
    kernel_tile.keys = packed;
    kernel_tile.values = packed + plan_.key_words;
    kernel_tile.block_keys = blocks_.counts.data();
    kernel_tile.head_words = plan_.head.head_words;
    kernel_tile.head_rows = plan_.head.head_rows;
    kernel_tile.head_dim = dim;
    kernel_tile.blocks = blocks_.count();
    kernel_tile.scratch = scratch;
    kernel_tile.output = outputs;
    kernel_tile.output_stride = dim;
    kernel_tile.base2_lse = base2_lse;
    unit_.attention_forward(kernel_tile);
    for (int64_t i = 0; i < tile.count; ++i) {
      const int64_t token = tile.first + i;
      float* to = row_of(arrays_.output, batch, head, token);
      prefetch_row(to + kPrefetchRows * arrays_.output.token_stride, shape_.head_dim);
      encoder_.apply(Encoding::output, token, 1.0f, outputs + i * dim, to);
      if (arrays_.log_sum_exp != nullptr) {
        arrays_.log_sum_exp[index * shape_.queries + token] =
            static_cast<float>(kLn2 * static_cast<double>(base2_lse[i]));
      }
    }
  }

  const AttentionForward& arrays_;
  const AttentionShape& shape_;
  const MatrixUnitKernels& unit_;
  Encoder encoder_;
  TokenBlocks blocks_;
  UnitAttentionPlan plan_;
  int threads_;
};

}  // namespace

void unit_attention_forward(const AttentionForward& arrays, const KernelSettings& settings) {
  UnitAttention(arrays, settings).run();
}

int64_t unit_attention_scratch_bytes(const AttentionForward& arrays, const KernelSettings& settings) {
  return UnitAttention(arrays, settings).scratch_bytes();
}

}  // namespace gld
