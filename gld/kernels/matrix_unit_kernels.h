#pragma once

#include "gld/kernels/kernel_table.h"
#include "gld/machine/matrix_unit.h"

#include <cstdint>

// The innermost loops in bfloat16 and int8, compiled once per matrix unit, beside the float32 ones of kernel_table.h.
// gld/kernels/packed_product.h and gld/kernels/attention_kernel.h are what other code calls.
//
// A matrix unit multiplies words of 4 bytes, 2 bfloat16 or 4 int8 numbers that are multiplied one by one with those of
// another word and summed: c[m][n] += sum over words k of a[m][k] . b[k][n]. The left operand has its rows one after
// the other, as the tile registers want them and as vectors broadcast them; the right operand has the lanes of one word
// side by side.
namespace gld {

// Rows of left operands are padded with zeros to whole steps: one row of a tile register, 64 bytes.
constexpr int64_t kStepWords = 16;

// This computes y = a b, or y += a b, for one strip of rows and some panels of columns.
struct UnitProductTile {
  const uint32_t* a;  // MatrixUnitKernels::rows rows that can be read
  int64_t a_stride;   // words
  const uint32_t* b;  // panels, `words` x MatrixUnitKernels::lanes each, one after another
  int64_t words;      // a multiple of MatrixUnitKernels::step_words
  int64_t rows;       // at most MatrixUnitKernels::rows
  int64_t columns;    // of all panels
  bool first;         // sets y and adds the bias, instead of adding to y
  const float* bias;  // (columns) or null
  float* y;
  int64_t y_stride;
  // int8 only: y = (a b - row_zeros column_sums) row_scales column_scales.
  const float* row_scales;     // (rows)
  const int32_t* row_zeros;    // (rows)
  const float* column_scales;  // (columns)
  const int32_t* column_sums;  // (columns), of b over these words
};

// How a row of floats becomes unsigned bytes: x = scale (byte - zero).
struct ByteScale {
  float scale;
  int32_t zero;
};

// Tokens lie in blocks of this many, each with its first one at an even place: keys and values in the forward pass,
// queries and gradients of the output in the backward pass.
constexpr int64_t kBlockTokens = 96;
constexpr int64_t kBlockPairs = kBlockTokens / 2;

// Some queries against the keys of one head, in bfloat16 with a softmax in float32.
struct UnitAttentionTile {
  const uint32_t* queries;    // query_count rows of head_words, multiplied by log2(e) / sqrt(head size)
  int64_t query_count;        // at most MatrixUnitKernels::forward_queries
  const uint32_t* keys;       // blocks of kBlockTokens rows of head_words
  const uint32_t* values;     // blocks of head_rows rows (channels) of kBlockPairs (pairs of keys)
  const int32_t* block_keys;  // how many keys of a block are there; the others are zero
  int64_t head_words;         // of a row: channels / 2, padded to whole steps
  int64_t head_rows;          // channels, padded to whole MatrixUnitKernels::rows
  int64_t head_dim;           // a multiple of 8
  int64_t blocks;
  float* scratch;  // MatrixUnitKernels::forward_scratch floats, 64-byte aligned
  float* output;   // query_count rows of output_stride
  int64_t output_stride;
  float* base2_lse;  // (query_count) log2 of the sum of 2^logit; -inf for a query without keys
};

// Some keys of one head, with gradients of the queries that attend to them; as UnitAttentionTile.
struct UnitAttentionBackwardTile {
  const uint32_t* queries;  // blocks of kBlockTokens rows of head_words, times log2(e) / sqrt(head size)
  const uint32_t* query_channels;    // the same, blocks of head_rows rows (channels) of kBlockPairs (pairs)
  const uint32_t* output_gradients;  // as queries
  const uint32_t* output_gradient_channels;  // as query_channels
  const int32_t* block_queries;              // how many queries of a block are there; the others are zero
  const float* base2_lse;                    // (blocks, kBlockTokens), as UnitAttentionTile::base2_lse
  const float* output_dot;                   // (blocks, kBlockTokens): output . output gradient
  const uint32_t* keys;                      // key_count rows of head_words
  const uint32_t* values;                    // the same
  int64_t key_count;                         // at most MatrixUnitKernels::backward_keys
  int64_t head_words;
  int64_t head_rows;
  int64_t head_dim;
  int64_t blocks;
  float* scratch;                 // MatrixUnitKernels::backward_scratch floats, 64-byte aligned
  float* query_gradients;         // (blocks, kBlockTokens, query_gradient_stride), added to
  int64_t query_gradient_stride;  // whole panels of MatrixUnitKernels::lanes channels
  float* key_gradients;           // key_count rows of gradient_stride
  float* value_gradients;         // the same
  int64_t gradient_stride;
};

// The table is filled by kernels_of() of matrix_unit_loops.h; kernel_table_test refuses an entry that is not.
struct MatrixUnitKernels {
  MatrixUnit unit = MatrixUnit::kPlain;
  int64_t rows = 0;             // of a product's strip
  int64_t lanes = 0;            // of a panel of columns
  int64_t step_words = 0;       // depths are multiples of it
  int64_t block_words = 0;      // of a row that is multiplied before sums go to y
  int64_t block_columns = 0;    // whose panels stay in the second-level cache
  int64_t forward_queries = 0;  // the most queries in an attention tile
  int64_t (*forward_scratch)(int64_t head_words, int64_t head_rows) = nullptr;
  int64_t backward_keys = 0;  // the most keys in a tile of the backward pass
  int64_t (*backward_scratch)(int64_t head_words, int64_t head_rows) = nullptr;
  void (*bfloat16_product)(const UnitProductTile& tile) = nullptr;
  void (*int8_product)(const UnitProductTile& tile) = nullptr;
  void (*attention_forward)(const UnitAttentionTile& tile) = nullptr;
  void (*attention_backward)(const UnitAttentionBackwardTile& tile) = nullptr;
  // Numbers are rounded to the nearest, ties to even; NaN stays NaN. From count to padded there are zeros.
  void (*to_bfloat16)(const float* x, int64_t count, int64_t padded, uint16_t* y) = nullptr;
  // Returns the scale that holds all numbers and 0; it is NaN where one is NaN or infinite.
  ByteScale (*byte_scale)(const float* x, int64_t count) = nullptr;
  void (*to_bytes)(const float* x, int64_t count, int64_t padded, const ByteScale& scale,
                   uint8_t* y) = nullptr;
  // Run rounds of independent products in registers and return how many operations that was.
  double (*bfloat16_rounds)(int64_t rounds) = nullptr;
  double (*int8_rounds)(int64_t rounds) = nullptr;
};

// Returns the kernels of one unit, which must be available for that precision (not float32) on this processor.
const MatrixUnitKernels& matrix_unit_kernels(MatrixUnit unit, ComputePrecision precision);

}  // namespace gld
