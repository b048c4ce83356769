// Compiled with its own flags (gld/CMakeLists.txt); see gld/simd.h for what may be included here.
#include "gld/attention_tiles.h"
#include "gld/element_tiles.h"
#include "gld/kernel_table.h"
#include "gld/kernel_variants.h"

namespace gld {

const KernelTable& avx512_kernels() {
  static const KernelTable table = {InstructionSet::avx512,
                                    kTileLanes,
                                    kForwardGroups * kTileLanes,
                                    kBackwardGroups * kTileLanes,
                                    forward_scratch_floats,
                                    backward_scratch_floats,
                                    attention_forward_tile,
                                    attention_backward_tile,
                                    encode_packed_row,
                                    rms_norm_rows,
                                    swiglu_rows,
                                    gated_sum_rows,
                                    multiply_add_rounds};
  return table;
}

}  // namespace gld
