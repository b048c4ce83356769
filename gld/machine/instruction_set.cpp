#include "gld/machine/instruction_set.h"

#include <unistd.h>

namespace gld {

std::vector<InstructionSet> available_instruction_sets() {
  std::vector<InstructionSet> sets = {InstructionSet::kPortable};
#ifdef GLD_X86_KERNELS
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) sets.push_back(InstructionSet::kAvx2);
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq"))
    sets.push_back(InstructionSet::kAvx512);
#endif
  return sets;
}

InstructionSet best_instruction_set() { return available_instruction_sets().back(); }

int64_t second_level_cache_bytes() {
  static const int64_t bytes = [] {
    int64_t known = 0;
#ifdef _SC_LEVEL2_CACHE_SIZE
    known = ::sysconf(_SC_LEVEL2_CACHE_SIZE);
#endif
    return known > 0 ? known : int64_t{256} << 10;
  }();
  return bytes;
}

std::string instruction_set_name(InstructionSet set) {
  switch (set) {
    case InstructionSet::kAvx512:
      return "AVX-512";
    case InstructionSet::kAvx2:
      return "AVX2";
    default:
      return "portable";
  }
}

}  // namespace gld
