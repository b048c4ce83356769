#pragma once

#include "gld/kernels/attention_tiles.h"
#include "gld/kernels/element_tiles.h"
#include "gld/kernels/kernel_table.h"
#include "gld/kernels/product_tiles.h"
#include "gld/kernels/sparse_rows.h"
#include "gld/kernels/splat_strips.h"
#include "gld/kernels/stereo_rows.h"

namespace gld {
namespace {

// Returns the kernels as the including file compiles them; see gld/kernels/simd.h for what such a file may include.
KernelTable compiled_kernels(InstructionSet set) {
  KernelTable table;
  table.instruction_set = set;
  table.tile_lanes = kTileLanes;
  table.tile_rows = kTileRows;
  table.forward_queries = kForwardGroups * kTileLanes;
  table.backward_keys = kBackwardGroups * kTileLanes;
  table.forward_scratch = forward_scratch_floats;
  table.backward_scratch = backward_scratch_floats;
  table.attention_forward = attention_forward_tile;
  table.attention_backward = attention_backward_tile;
  table.encode_row = encode_packed_row;
  table.pack_rows = pack_rows_transposed;
  table.product = product_tile;
  table.few_rows_product = few_rows_tile;
  table.rms_norm = rms_norm_rows;
  table.swiglu = swiglu_rows;
  table.gated_sum = gated_sum_rows;
  table.warp_row = warp_picture_row;
  table.correlate_row = correlate_window_row;
  table.plane_cost_row = plane_cost_of_row;
  table.add_prior_costs = add_prior_to_costs;
  table.path_step = step_paths;
  table.least_cost = find_least_cost;
  table.splat_strip = Simd::lanes;
  table.splat_weights = weigh_splats;
  table.splat_channels = composite_splat_channels;
  table.splat_slopes = splat_slopes_of_strip;
  table.splat_sums = sum_splat_gradients;
  table.sparse_rows = sum_sparse_rows;
  table.weighted_rows = sum_weighted_rows;
  table.multiply_add_loop = multiply_add_rounds;
  return table;
}

}  // namespace
}  // namespace gld
