#pragma once

#include "gld/kernels/attention_rows.h"
#include "gld/kernels/matrix_unit_kernels.h"

#include <cstdint>
#include <vector>

// What attention's two passes on matrix units share: tokens in blocks, and one head's tokens as the units take them.
namespace gld {

// Returns the unit's kernels. Throws Error for another precision than bfloat16.
const MatrixUnitKernels& attention_unit(const KernelSettings& settings);

// Tokens in blocks of kBlockTokens.
struct TokenBlocks {
  std::vector<TokenRange> tokens;  // of each block
  std::vector<int32_t> counts;     // the same as the kernels take it

  int64_t count() const { return static_cast<int64_t>(tokens.size()); }
};

TokenBlocks token_blocks(int64_t tokens);

// Sizes of one head's packed tokens.
struct UnitHead {
  int64_t head_dim = 0;    // padded to 8: what is computed with
  int64_t head_words = 0;  // of a row of channels
  int64_t head_rows = 0;   // channels of a block of pairs

  UnitHead(int64_t channels, const MatrixUnitKernels& unit);
  int64_t block_rows() const { return kBlockTokens * head_words; }    // words of a block as rows
  int64_t block_channels() const { return kBlockPairs * head_rows; }  // words of a block as channels
};

inline uint16_t* halves(uint32_t* words) { return reinterpret_cast<uint16_t*>(words); }

// Packs a block of which rows (kBlockTokens, row_halves) are there as bfloat16, as channels of pairs of tokens. Rows
// past the block's tokens are zero.
void pack_channels(const UnitHead& head, const uint16_t* rows, int64_t row_halves, uint32_t* channels);

}  // namespace gld
