#include "gld/kernels/unit_attention_blocks.h"

#include "gld/base/error.h"
#include "gld/kernels/product_shares.h"

#include <algorithm>

namespace gld {

const MatrixUnitKernels& attention_unit(const KernelSettings& settings) {
  if (settings.precision != ComputePrecision::kBFloat16) {
    fail({"attention kernel", "float32 or bfloat16", compute_precision_name(settings.precision), ""});
  }
  return matrix_unit_kernels(settings.unit, settings.precision);
}

TokenBlocks token_blocks(int64_t tokens, const ViewMask* mask) {
  TokenBlocks blocks;
  blocks.views = mask == nullptr ? 1 : mask->views;
  blocks.view_tokens = tokens / blocks.views;
  for (int64_t view = 0; view < blocks.views; ++view) {
    for (int64_t first = 0; first < blocks.view_tokens; first += kBlockTokens) {
      blocks.tokens.push_back(
          {view * blocks.view_tokens + first, std::min(kBlockTokens, blocks.view_tokens - first)});
      blocks.counts.push_back(static_cast<int32_t>(blocks.tokens.back().count));
    }
  }
  return blocks;
}

std::vector<std::vector<TokenRange>> block_runs(const std::vector<Segment>& segments,
                                                const TokenBlocks& blocks) {
  std::vector<std::vector<TokenRange>> runs(segments.size());
  if (blocks.view_tokens == 0) return runs;
  for (std::size_t i = 0; i < segments.size(); ++i) {
    for (const TokenRange& tokens : segments[i].partners) {
      runs[i].push_back({tokens.first / blocks.view_tokens * blocks.a_view(),
                         tokens.count / blocks.view_tokens * blocks.a_view()});
    }
  }
  return runs;
}

UnitHead::UnitHead(int64_t channels, const MatrixUnitKernels& unit)
    : head_dim(rounded_up(channels, 8)),
      head_words(rounded_up(head_dim / 2, kStepWords)),
      head_rows(rounded_up(head_dim, unit.rows)) {}

void pack_channels(const UnitHead& head, const uint16_t* rows, int64_t row_halves, uint32_t* channels) {
  for (int64_t w = 0; w < kBlockPairs; ++w) {
    const uint16_t* even = rows + 2 * w * row_halves;
    const uint16_t* odd = even + row_halves;
    for (int64_t c = 0; c < head.head_dim; ++c) {
      channels[c * kBlockPairs + w] = static_cast<uint32_t>(odd[c]) << 16 | even[c];
    }
  }
  std::fill(channels + head.head_dim * kBlockPairs, channels + head.block_channels(), 0U);
}

}  // namespace gld
