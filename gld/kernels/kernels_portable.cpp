// Compiled with flags of its own (gld/kernels/CMakeLists.txt).
#include "gld/kernels/compiled_kernels.h"
#include "gld/kernels/kernel_variants.h"

namespace gld {

const KernelTable& portable_kernels() {
  static const KernelTable table = compiled_kernels(InstructionSet::kPortable);
  return table;
}

}  // namespace gld
