// Compiled with its own flags (gld/CMakeLists.txt); see gld/kernels/simd.h for what may be included here.
#include "gld/kernels/attention_tiles.h"
#include "gld/kernels/element_tiles.h"
#include "gld/kernels/kernel_table.h"
#include "gld/kernels/kernel_variants.h"
#include "gld/kernels/product_tiles.h"

namespace gld {

const KernelTable& avx512_kernels() {
  static const KernelTable table = {InstructionSet::kAvx512,
                                    kTileLanes,
                                    kTileRows,
                                    kForwardGroups * kTileLanes,
                                    kBackwardGroups * kTileLanes,
                                    forward_scratch_floats,
                                    backward_scratch_floats,
                                    attention_forward_tile,
                                    attention_backward_tile,
                                    encode_packed_row,
                                    pack_rows_transposed,
                                    product_tile,
                                    rms_norm_rows,
                                    swiglu_rows,
                                    gated_sum_rows,
                                    multiply_add_rounds};
  return table;
}

}  // namespace gld
