#include "gld/kernels/matrix_product.h"

#include "gld/base/error.h"
#include "gld/kernels/aligned_floats.h"
#include "gld/kernels/kernel_table.h"
#include "gld/kernels/product_shares.h"

#include <algorithm>
#include <string>

#include <omp.h>

namespace gld {
namespace {

constexpr int64_t kColumns = 192;
// So many inputs are summed up before they are added to y: longer sums in one accumulator lose digits.
constexpr int64_t kSummedInputs = 256;

// Returns how many of these sums a block of packed weights takes. It stays in the second-level cache while all rows
// pass, as y does in the first between its sums: 3 are 6 % faster than 1 with 1 MiB, where they take 576 KiB; 1 is for
// 256 KiB.
int64_t sums_a_block(int64_t cache) {
  constexpr int64_t kBytes = kSummedInputs * kColumns * int64_t{sizeof(float)};
  return std::clamp<int64_t>(cache / 16 * 9 / kBytes, 1, 3);
}

void check_product(const LinearProduct& product, const KernelSettings& settings) {
  if (product.rows >= 0 && product.inputs >= 1 && product.outputs >= 1 && settings.threads >= 1 &&
      product.x_stride >= product.inputs && product.weight_stride >= product.inputs &&
      product.y_stride >= product.outputs) {
    return;
  }
  fail({"matrix product", "rows, inputs and outputs that fit their strides, and at least one thread",
        std::to_string(product.rows) + " x " + std::to_string(product.inputs) + " times " +
            std::to_string(product.inputs) + " x " + std::to_string(product.outputs),
        ""});
}

// How the weights are cut up (Goto and van de Geijn 2008): into blocks of outputs, these into blocks of inputs, these
// into panels of tile_lanes outputs.
struct WeightLayout {
  int64_t summed;   // inputs of a sum
  int64_t depth;    // inputs of a block: some sums
  int64_t columns;  // outputs of a block, a multiple of tile_lanes
  int64_t column_blocks;
};

WeightLayout weight_layout(int64_t outputs, int64_t inputs, const KernelTable& kernels, int64_t cache) {
  WeightLayout layout = {};
  layout.summed = equal_share(inputs, kSummedInputs, 4);
  layout.depth = std::min(layout.summed * sums_a_block(cache), inputs);
  layout.columns = equal_share(outputs, std::max(kColumns, kernels.tile_lanes), kernels.tile_lanes);
  layout.column_blocks = parts_of(outputs, layout.columns);
  return layout;
}

struct WeightBlock {
  int64_t first_column;
  int64_t columns;
  TokenRange inputs;
};

void pack_columns(const float* weight, int64_t stride, const KernelTable& kernels, const WeightBlock& block,
                  float* packed) {
  for (int64_t n = 0; n < block.columns; n += kernels.tile_lanes) {
    PackedRows rows = {};
    rows.x = weight + (block.first_column + n) * stride + block.inputs.first;
    rows.stride = stride;
    rows.count = std::min(kernels.tile_lanes, block.columns - n);
    rows.width = kernels.tile_lanes;
    rows.depth = block.inputs.count;
    rows.packed = packed + n * block.inputs.count;
    kernels.pack_rows(rows);
  }
}

// Returns where a block lies among all packed weights.
int64_t block_offset(const WeightBlock& block, int64_t all_inputs, const KernelTable& kernels) {
  return block.first_column * all_inputs + rounded_up(block.columns, kernels.tile_lanes) * block.inputs.first;
}

// Calls part(block) for all blocks, shared out between the threads.
template <class Part>
void for_weight_blocks(int64_t outputs, int64_t inputs, const KernelSettings& settings, const Part& part) {
  const WeightLayout layout =
      weight_layout(outputs, inputs, kernel_table(settings.instruction_set), settings.second_level_cache);
#pragma omp parallel for num_threads(settings.threads) schedule(static)
  for (int64_t item = 0; item < layout.column_blocks; ++item) {
    const int64_t column = item * layout.columns;
    for (int64_t k = 0; k < inputs; k += layout.depth) {
      part(WeightBlock{
          column, std::min(layout.columns, outputs - column), {k, std::min(layout.depth, inputs - k)}});
    }
  }
}

// How the rows are shared out.
struct Plan : WeightLayout {
  int64_t rows;       // packed at once
  int64_t row_parts;  // that share out a block of outputs, where there are few of those
  int64_t rows_a_part;
};

Plan make_plan(const LinearProduct& product, const KernelTable& kernels, const KernelSettings& settings) {
  Plan plan = {};
  static_cast<WeightLayout&>(plan) =
      weight_layout(product.outputs, product.inputs, kernels, settings.second_level_cache);
  plan.rows = equal_share(product.rows, kRowsPackedAtOnce, kernels.tile_rows);
  const int64_t wanted = parts_of(kPartsAThread * settings.threads, plan.column_blocks);
  plan.row_parts =
      settings.threads == 1 ? 1 : std::clamp<int64_t>(wanted, 1, parts_of(plan.rows, kRowsAPart));
  plan.rows_a_part = equal_share(plan.rows, parts_of(plan.rows, plan.row_parts), kernels.tile_rows);
  return plan;
}

// Packs one strip of tile_rows rows in its place among the packed (blocks of inputs, strips, inputs, tile_rows).
void pack_strip(const LinearProduct& product, const KernelTable& kernels, const Plan& plan, int64_t first_row,
                int64_t strip, float* packed) {
  const int64_t row = first_row + strip * kernels.tile_rows;
  for (int64_t k = 0; k < product.inputs; k += plan.depth) {
    PackedRows rows = {};
    rows.x = product.x + row * product.x_stride + k;
    rows.stride = product.x_stride;
    rows.count = std::min(kernels.tile_rows, product.rows - row);
    rows.width = kernels.tile_rows;
    rows.depth = std::min(plan.depth, product.inputs - k);
    rows.packed = packed + plan.rows * k + strip * kernels.tile_rows * rows.depth;
    kernels.pack_rows(rows);
  }
}

}  // namespace

void linear_product(const LinearProduct& product, const KernelSettings& settings) {
  check_product(product, settings);
  if (product.rows == 0) return;
  const KernelTable& kernels = kernel_table(settings.instruction_set);
  const Plan plan = make_plan(product, kernels, settings);
  const AlignedFloats packed_rows(plan.rows * product.inputs);
  const bool packed = product.packed_weight != nullptr;
  const AlignedFloats packed_columns(packed ? 0 : settings.threads * plan.columns * plan.depth);
  for (int64_t first_row = 0; first_row < product.rows; first_row += plan.rows) {
    const int64_t rows = std::min(plan.rows, product.rows - first_row);
    const int64_t strips = parts_of(rows, kernels.tile_rows);
#pragma omp parallel num_threads(settings.threads)
    {
#pragma omp for schedule(static)
      for (int64_t strip = 0; strip < strips; ++strip) {
        pack_strip(product, kernels, plan, first_row, strip, packed_rows.data());
      }
      float* weights = packed_columns.data() + omp_get_thread_num() * plan.columns * plan.depth;
#pragma omp for schedule(dynamic, 1)
      for (int64_t item = 0; item < plan.column_blocks * plan.row_parts; ++item) {
        const int64_t column = item / plan.row_parts * plan.columns;
        const int64_t columns = std::min(plan.columns, product.outputs - column);
        const int64_t first = item % plan.row_parts * plan.rows_a_part;
        const int64_t last = std::min(first + plan.rows_a_part, rows);
        for (int64_t k = 0; k < product.inputs && first < last; k += plan.depth) {
          const TokenRange inputs = {k, std::min(plan.depth, product.inputs - k)};
          const WeightBlock block = {column, columns, inputs};
          if (!packed) pack_columns(product.weight, product.weight_stride, kernels, block, weights);
          for (int64_t row = first; row < last; row += kernels.tile_rows) {
            ProductTile tile = {};
            tile.a = packed_rows.data() + plan.rows * k + row * inputs.count;
            tile.b = packed ? product.packed_weight + block_offset(block, product.inputs, kernels) : weights;
            tile.depth = inputs.count;
            tile.summed = plan.summed;
            tile.rows = std::min(kernels.tile_rows, last - row);
            tile.columns = columns;
            tile.first = k == 0;
            tile.bias = product.bias == nullptr ? nullptr : product.bias + column;
            tile.y = product.y + (first_row + row) * product.y_stride + column;
            tile.y_stride = product.y_stride;
            kernels.product(tile);
          }
        }
      }
    }
  }
}

void few_rows_product(const LinearProduct& product, const KernelSettings& settings) {
  check_product(product, settings);
  if (product.rows == 0) return;
  const KernelTable& kernels = kernel_table(settings.instruction_set);
  // Outputs a thread takes at a time, and multiplications below which waking another thread costs more than it does.
  constexpr int64_t kOutputsAPart = 48;
  constexpr int64_t kFewestShared = 1 << 17;
  const int64_t parts = parts_of(product.outputs, kOutputsAPart);
  const bool shared = product.rows * product.inputs * product.outputs >= kFewestShared;
#pragma omp parallel for num_threads(shared ? settings.threads : 1) schedule(static)
  for (int64_t part = 0; part < parts; ++part) {
    const int64_t first = part * kOutputsAPart;
    FewRowsTile tile = {};
    tile.x = product.x;
    tile.x_stride = product.x_stride;
    tile.rows = product.rows;
    tile.weight = product.weight + first * product.weight_stride;
    tile.weight_stride = product.weight_stride;
    tile.outputs = std::min(kOutputsAPart, product.outputs - first);
    tile.inputs = product.inputs;
    tile.bias = product.bias == nullptr ? nullptr : product.bias + first;
    tile.y = product.y + first;
    tile.y_stride = product.y_stride;
    kernels.few_rows_product(tile);
  }
}

int64_t packed_weight_floats(int64_t outputs, int64_t inputs, const KernelSettings& settings) {
  return rounded_up(outputs, kernel_table(settings.instruction_set).tile_lanes) * inputs;
}

void pack_weight(const LinearProduct& product, const KernelSettings& settings, float* packed) {
  const KernelTable& kernels = kernel_table(settings.instruction_set);
  for_weight_blocks(product.outputs, product.inputs, settings, [&](const WeightBlock& block) {
    pack_columns(product.weight, product.weight_stride, kernels, block,
                 packed + block_offset(block, product.inputs, kernels));
  });
}

void unpack_weight(const LinearProduct& product, const KernelSettings& settings, float* weight) {
  const KernelTable& kernels = kernel_table(settings.instruction_set);
  for_weight_blocks(product.outputs, product.inputs, settings, [&](const WeightBlock& block) {
    const float* from = product.packed_weight + block_offset(block, product.inputs, kernels);
    for (int64_t n = 0; n < block.columns; ++n) {
      const float* panel = from + n / kernels.tile_lanes * kernels.tile_lanes * block.inputs.count;
      float* to = weight + (block.first_column + n) * product.inputs + block.inputs.first;
      for (int64_t k = 0; k < block.inputs.count; ++k)
        to[k] = panel[k * kernels.tile_lanes + n % kernels.tile_lanes];
    }
  });
}

}  // namespace gld
