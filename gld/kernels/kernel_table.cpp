#include "gld/kernels/kernel_table.h"

#include "gld/base/error.h"
#include "gld/kernels/kernel_variants.h"

#include <algorithm>

namespace gld {

const KernelTable& kernel_table(InstructionSet set) {
  const auto available = available_instruction_sets();
  if (std::find(available.begin(), available.end(), set) == available.end()) {
    fail({"kernels", "an instruction set this processor and build offer", instruction_set_name(set),
          "use " + instruction_set_name(available.back())});
  }
#ifdef GLD_X86_KERNELS
  if (set == InstructionSet::kAvx512) return avx512_kernels();
  if (set == InstructionSet::kAvx2) return avx2_kernels();
#endif
  return portable_kernels();
}

}  // namespace gld
