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

TokenBlocks token_blocks(int64_t tokens) {
  TokenBlocks blocks;
  blocks.tokens = tiles(tokens, kBlockTokens);
  for (const TokenRange& block : blocks.tokens) blocks.counts.push_back(static_cast<int32_t>(block.count));
  return blocks;
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
