// Compiled with flags of its own (gld/kernels/CMakeLists.txt).
#include "gld/kernels/compiled_kernels.h"
#include "gld/kernels/kernel_variants.h"

namespace gld {

const KernelTable& avx2_kernels() {
  static const KernelTable table = compiled_kernels(InstructionSet::kAvx2);
  return table;
}

}  // namespace gld
