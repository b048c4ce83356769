#pragma once

#include "gld/machine/instruction_set.h"

#include <cstddef>
#include <cstdint>

// The innermost loops, compiled once per instruction set. Plain pointers and counts only: what these files
// share with the rest of the program is this header, so that no inline function compiled for a wider
// processor can leak into code that runs everywhere. gld/kernels/attention_kernel.h, gld/kernels/matrix_product.h and
// gld/tensors/fused_ops.h are what other code calls.
namespace gld {

// A run of consecutive keys or queries: rows first .. first + count - 1 of the packed matrices.
struct TokenRange {
  int64_t first;
  int64_t count;
};

// Packed matrices hold one token a row, `stride` floats apart, channels in front and zeros behind them.
// Kernels read up to kPackedRowPadding rows past the last token, which must exist and be finite.
constexpr int64_t kPackedRowPadding = 16;

// Some queries against the keys of one head.
struct AttentionForwardTile {
  const float* queries;  // packed, already multiplied by log2(e) / sqrt(head size)
  int64_t query_count;   // at most KernelTable::forward_queries
  const float* keys;     // packed
  const float* values;   // packed
  int64_t stride;
  int64_t head_dim;  // a multiple of 8
  const TokenRange* key_ranges;
  int64_t key_range_count;
  float* scratch;    // KernelTable::forward_scratch floats, 64-byte aligned
  float* output;     // packed, query_count rows
  float* base2_lse;  // (query_count) log2 of the sum of 2^logit; -inf for a query without keys
};

// The keys of one tile against all the queries that see them.
struct AttentionBackwardTile {
  const float* queries;           // packed, multiplied as in the forward tile
  const float* output_gradients;  // packed, d loss / d output
  const float* base2_lse;         // (queries)
  const float* output_dot;        // (queries) output . output gradient
  const float* keys;              // packed, row 0 is the tile's first key
  const float* values;            // packed, row 0 is the tile's first key
  int64_t key_count;              // at most KernelTable::backward_keys
  int64_t stride;
  int64_t head_dim;
  const TokenRange* query_ranges;
  int64_t query_range_count;
  float* scratch;          // KernelTable::backward_scratch floats, 64-byte aligned
  float* query_gradients;  // packed, all queries; ADDED to, up to a factor (see attention_kernel.cpp)
  float* key_gradients;    // packed, key_count rows; set, up to a factor
  float* value_gradients;  // packed, key_count rows; set
};

// Camera encoding of packed rows (PRoPE, see gld/cameras/prope.h): 4x4 products on the first half of the channels,
// then one rotation a quarter.
struct PropeRow {
  const float* matrix;  // (4, 4) row-major, multiplied from the left
  const float* column_cos;
  const float* column_sin;
  const float* row_cos;
  const float* row_sin;
  bool inverse_rotation;
  bool transposed_matrix;
};

// RMSNorm with an optional weight and modulation: y = x / rms(x) * weight * (1 + scale) + shift.
struct RmsNormRows {
  const float* x;
  int64_t rows;
  int64_t channels;
  int64_t x_stride;
  double epsilon;
  const float* weight;  // (channels) or null
  const float* scale;   // row r uses scale + (r / rows_per_modulation) * modulation_stride; null for none
  const float* shift;   // likewise
  int64_t rows_per_modulation;
  int64_t modulation_stride;
  int64_t first_row;  // counted in r above
  float* y;           // rows of `channels` floats, contiguous
};

// y = silu(a) * b.
struct SwigluRows {
  const float* a;
  const float* b;
  int64_t rows;
  int64_t channels;
  int64_t stride;  // of a and b
  float* y;
  int64_t y_stride;
};

// y = x + gate * update, gate indexed as in RmsNormRows.
struct GatedSumRows {
  const float* x;
  const float* update;
  const float* gate;
  int64_t rows;
  int64_t channels;
  int64_t rows_per_gate;
  int64_t gate_stride;
  int64_t first_row;
  float* y;
};

// Rows whose channels are to lie in the lanes of tiles.
struct PackedRows {
  const float* x;
  int64_t stride;
  int64_t count;  // rows; those past it up to `width` become zeros
  int64_t width;  // a multiple of 4
  int64_t depth;  // channels
  float* packed;  // (depth, width)
};

// y = a b, or y += a b, for one strip of rows and some panels of columns.
struct ProductTile {
  const float* a;  // packed, `depth` x KernelTable::tile_rows
  const float* b;  // packed panels, `depth` x KernelTable::tile_lanes each, one after another
  int64_t depth;
  int64_t summed;     // inputs that are summed up before they are added to y
  int64_t rows;       // at most tile_rows
  int64_t columns;    // of all panels
  bool first;         // sets y and adds the bias, instead of adding to y
  const float* bias;  // (columns) or null
  float* y;
  int64_t y_stride;
};

struct KernelTable {
  InstructionSet instruction_set;
  int64_t tile_lanes;       // tiles are best a multiple of it
  int64_t tile_rows;        // of a product
  int64_t forward_queries;  // the most queries in a forward tile
  int64_t backward_keys;    // the most keys in a backward tile
  int64_t (*forward_scratch)(int64_t head_dim);
  int64_t (*backward_scratch)(int64_t head_dim);
  void (*attention_forward)(const AttentionForwardTile& tile);
  void (*attention_backward)(const AttentionBackwardTile& tile);
  // y = encoded x * factor; x and y have head_dim floats and may not overlap; encoding null for a plain copy.
  void (*encode_row)(const PropeRow* encoding, int64_t head_dim, float factor, const float* x, float* y);
  void (*pack_rows)(const PackedRows& rows);
  void (*product)(const ProductTile& tile);
  void (*rms_norm)(const RmsNormRows& rows);
  void (*swiglu)(const SwigluRows& rows);
  void (*gated_sum)(const GatedSumRows& rows);
  // Runs `rounds` rounds of independent multiply-adds and returns how many floating-point operations that
  // was.
  double (*multiply_add_loop)(int64_t rounds);
};

// The kernels of one instruction set, which must be available on this processor.
const KernelTable& kernel_table(InstructionSet set);

}  // namespace gld
