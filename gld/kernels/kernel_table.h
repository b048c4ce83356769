#pragma once

#include "gld/machine/instruction_set.h"

#include <cstddef>
#include <cstdint>

// The innermost loops, compiled once per instruction set. They take plain pointers and counts only: what these files
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
  int64_t key_count;
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
  int64_t query_count;
  float* scratch;          // KernelTable::backward_scratch floats, 64-byte aligned
  float* query_gradients;  // packed, all queries; ADDED to, up to a factor (see attention_kernel.cpp)
  float* key_gradients;    // packed, key_count rows; set, up to a factor
  float* value_gradients;  // packed, key_count rows; set
};

// Camera encoding of packed rows (PRoPE, see gld/camera_encoding/prope.h): 4x4 products on the first half of the
// channels, then one rotation a quarter.
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

// y = x + gate * update, where gate is indexed as in RmsNormRows.
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

// This computes y = a b, or y += a b, for one strip of rows and some panels of columns.
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

// This computes y = x weight^T + bias for few rows: sums along the inputs, in which both lie one after another, without
// packing.
struct FewRowsTile {
  const float* x;
  int64_t x_stride;
  int64_t rows;
  const float* weight;
  int64_t weight_stride;
  int64_t outputs;
  int64_t inputs;
  const float* bias;  // (outputs) or null
  float* y;
  int64_t y_stride;
};

// A photograph ready to be looked up anywhere: for every pixel its brightness and that of the pixels to its right,
// below and to the lower right, from -kTexelOne to kTexelOne, lowest bits first, with a border of one pixel that is not
// seen all around. Bit 0 of the first says that the pixel is not seen.
struct TexelPicture {
  const uint64_t* texels;  // (height, width)
  int64_t width;           // with the border
  int64_t height;
};
constexpr int64_t kTexelOne = 16382;  // even

// One row of a picture as another photograph shows it: pixel i is at (X, Y) / Z with (X, Y, Z) = first + i step,
// counted in texels.
struct WarpedRow {
  TexelPicture from;
  const float* first;  // (3)
  const float* step;   // (3)
  int64_t count;
  float* brightness;  // (count) bilinear, from -1 to 1; 0 where not seen
  float* seen;  // (count) 1, or 0 behind the camera, outside of the photograph and where it has no value
};

// A window that lacks a pixel of the other photograph has this as its correlation.
constexpr float kNotSeenCorrelation = -2.0F;
// Correlations are over windows of at most this many pixels to each side.
constexpr int64_t kMostWindowRadius = 7;
// Rows of sums have as many zeros before their first value, and this many behind their last.
constexpr int64_t kWindowPadding = 24;

// Moves windows one row on and correlates them with those of the reference (zero-mean, normalised).
struct CorrelatedRow {
  int64_t count;
  int64_t radius;
  const float* entering;            // (count) the row that comes into the windows
  const float* entering_reference;  // (count) the same row of the reference
  const float* leaving;             // (count) the row that leaves them
  const float* leaving_reference;
  float* sums;         // (3, kWindowPadding + count + kWindowPadding): columns of x, x x and x reference
  const float* share;  // (count) 1 / pixels in the window
  const float* mean;   // (count) of the reference
  const float*
      inverse_deviation;  // (count) 1 / sqrt(sum of squared deviations); 0 where the reference says nothing
  const float* seen;      // (count) of the middle row
  float noise;            // added to the other photograph's sum of squared deviations
  // (count) from -1 to 1, to 4e-4; kNotSeenCorrelation where not seen. Null: the windows are moved only.
  float* correlation;
};

// The cost of a plane is from the mean correlation of the better half of those photographs that see a pixel.
constexpr int64_t kMostSweptPhotographs = 4;
constexpr int64_t kDearestMatch = 160;  // correlation 0 and below; correlation 1 costs 0
constexpr int64_t kUnseenMatch = 161;
struct PlaneCostRow {
  int64_t count;
  int64_t photographs;                               // at most kMostSweptPhotographs
  const float* correlations[kMostSweptPhotographs];  // (count) each
  uint8_t* cost;                                     // (count)
};

// Adds min(dearest, steepness (places[i] - middle)^2), rounded down, to each cost.
struct PriorCosts {
  int64_t planes;
  const float* places;  // (planes)
  float middle;
  float steepness;
  float dearest;
  uint8_t* cost;  // (planes)
};

// The four paths that reach a pixel from the row before it or from the pixel before it.
constexpr int64_t kPathsAPass = 4;
// A path of P planes has kPathGuard values of kPathGuardCost before it and behind it.
constexpr int64_t kPathGuard = 16;
constexpr uint16_t kPathGuardCost = 0x4000;
// Counts of planes are rounded up to a multiple of it, with costs of 255.
constexpr int64_t kPlaneGroup = 16;

// A step of semi-global matching: after = cost + min(before, before of the next planes + small step, least before + big
// step) - least before.
struct PathStep {
  int64_t planes;       // a multiple of kPlaneGroup
  const uint8_t* cost;  // (planes)
  const uint16_t* before[kPathsAPass];
  uint16_t* after[kPathsAPass];
  uint16_t least[kPathsAPass];  // of before; set to that of after
  uint16_t small_step;
  uint16_t big_step[kPathsAPass];
  const uint16_t* sum_before;  // (planes), or null for zeros
  uint16_t* sum;               // (planes) sum_before and all paths; may be sum_before
};

// The least of some costs, and the least that is farther than `apart` planes from it.
struct LeastCost {
  const uint16_t* sum;
  int64_t planes;
  int64_t apart;
  int64_t plane;    // set; the first of equal ones
  uint16_t least;   // set
  uint16_t second;  // set; 0xFFFF where no plane is so far apart
};

// A Gaussian in a strip: KernelTable::splat_strip pixels of a row, the i-th of which it covers with
// alpha = min(kDensestAlpha, 2^(height - (slope i + shift)^2)), or not at all where that power of 2 is below
// 2^least_alpha_power. All finite.
struct SplatRow {
  float slope;
  float shift;
  float height;
  float across;  // the whitened distance that height holds already, for its moments
};
constexpr float kDensestAlpha = 0.99F;

// How much of each Gaussian of a strip is seen, front to back: weight = alpha times what those before it let through.
// A pixel of which less than least_transmittance would be left is done.
struct SplatWeights {
  const SplatRow* rows;    // of a tile
  const int32_t* records;  // (count) those of the strip, front to back
  int64_t count;
  float least_alpha_power;  // log2 of the alpha from which a Gaussian is there
  float least_transmittance;
  float* alpha;   // (count, splat_strip) set, before kDensestAlpha holds it; 0 where the pixel was done
  float* weight;  // (count, splat_strip) set
  float* transmittance;  // (splat_strip) set
};

// Channel c of the strip's pixels is the sum of weight and feature, and the background through what is left.
struct SplatChannels {
  const float* weight;  // (count, splat_strip)
  const float* transmittance;
  const int32_t* gaussians;  // (count) rows of features
  int64_t count;
  const float* features;  // (.., channels)
  int64_t channels;
  const float* background;  // (channels), or null for 0
  float* image;             // channel c at c plane
  int64_t plane;
};

// What reaches a Gaussian whose alpha is held at kDensestAlpha: nothing, as the function has it, or what would reach it
// if it were not held, as the published code has it.
enum class HeldAlphaGradient { kNone, kPublished };

// alpha d loss / d alpha of each Gaussian and pixel of a strip, and the weights, where its tile's records lie.
struct SplatSlopes {
  const float* alpha;   // (used, splat_strip), as weights were left
  const float* weight;  // (used, splat_strip)
  const float* transmittance;
  const int32_t* records;    // (count)
  const int32_t* gaussians;  // (count)
  int64_t count;
  int64_t used;  // those beyond are seen nowhere in the strip
  HeldAlphaGradient held;
  const float* features;
  int64_t channels;
  const float* background;
  const float* gradient;  // of the image, channel c at c plane
  int64_t plane;
  float* scratch;        // (count, splat_strip)
  float* record_weight;  // (records, splat_strip) set
  float* slope;          // (records, splat_strip) set; null where geometry has no gradient
};

// Sums over the records of each Gaussian of a tile.
constexpr int64_t kSplatMoments = 6;  // of the slope times 1, u, v, u u, u v, v v with u along and v across
struct SplatSums {
  int64_t count;                // Gaussians
  const int32_t* first_record;  // (count + 1)
  const SplatRow* rows;
  const int64_t* pixel;  // (records) offset of the strip in a plane
  const float* weight;   // (records, splat_strip)
  const float* slope;    // (records, splat_strip), or null
  const float* gradient;
  int64_t channels;
  int64_t plane;
  float* moments;   // (count, kSplatMoments) set where slope is there
  float* features;  // (count, channels) set: the sum of weight and gradient
};

// A sparse matrix by rows times a table of channels: rows `begin` to `end`, entries first[row] to first[row + 1].
constexpr int64_t kSparseStride = 16;  // what the table's stride is a multiple of: the widest vector
struct SparseRows {
  const int64_t* first;
  const int32_t* columns;
  const float* values;
  int64_t begin, end;
  const float* table;  // (columns, stride)
  int64_t stride;      // channels, those at the end perhaps unused
  float* sums;         // (rows, stride) set
};

// The sum of weights[k] rows[k].
constexpr int64_t kWeightedRows = 11;
struct WeightedRows {
  const float* rows[kWeightedRows];  // (count) each
  const float* weights;              // (kWeightedRows)
  int64_t count;
  float* sum;  // (count), none of the rows
};

// The table is filled in compiled_kernels.h; kernel_table_test refuses an entry that is not.
struct KernelTable {
  InstructionSet instruction_set = InstructionSet::kPortable;
  int64_t tile_lanes = 0;       // tiles are best a multiple of it
  int64_t tile_rows = 0;        // of a product
  int64_t forward_queries = 0;  // the most queries in a forward tile
  int64_t backward_keys = 0;    // the most keys in a backward tile
  int64_t splat_strip = 0;      // pixels of a row that splatting takes at a time
  int64_t (*forward_scratch)(int64_t head_dim) = nullptr;
  int64_t (*backward_scratch)(int64_t head_dim) = nullptr;
  void (*attention_forward)(const AttentionForwardTile& tile) = nullptr;
  void (*attention_backward)(const AttentionBackwardTile& tile) = nullptr;
  // Writes y = encoded x * factor; x and y have head_dim floats and may not overlap; encoding is null for a plain copy.
  void (*encode_row)(const PropeRow* encoding, int64_t head_dim, float factor, const float* x,
                     float* y) = nullptr;
  void (*pack_rows)(const PackedRows& rows) = nullptr;
  void (*product)(const ProductTile& tile) = nullptr;
  void (*few_rows_product)(const FewRowsTile& tile) = nullptr;
  void (*rms_norm)(const RmsNormRows& rows) = nullptr;
  void (*swiglu)(const SwigluRows& rows) = nullptr;
  void (*gated_sum)(const GatedSumRows& rows) = nullptr;
  void (*warp_row)(const WarpedRow& row) = nullptr;
  void (*correlate_row)(const CorrelatedRow& row) = nullptr;
  void (*plane_cost_row)(const PlaneCostRow& row) = nullptr;
  void (*add_prior_costs)(const PriorCosts& costs) = nullptr;
  void (*path_step)(PathStep& step) = nullptr;
  void (*least_cost)(LeastCost& cost) = nullptr;
  // Returns how many of the Gaussians were looked at before every pixel was done.
  int64_t (*splat_weights)(const SplatWeights& strip) = nullptr;
  void (*splat_channels)(const SplatChannels& strip) = nullptr;
  void (*splat_slopes)(const SplatSlopes& strip) = nullptr;
  void (*splat_sums)(const SplatSums& tile) = nullptr;
  void (*sparse_rows)(const SparseRows& rows) = nullptr;
  void (*weighted_rows)(const WeightedRows& rows) = nullptr;
  // Runs `rounds` rounds of independent multiply-adds and returns how many floating-point operations that was.
  double (*multiply_add_loop)(int64_t rounds) = nullptr;
};

// Returns the kernels of one instruction set, which must be available on this processor.
const KernelTable& kernel_table(InstructionSet set);

}  // namespace gld
