#include "gld/machine/instruction_set.h"

#include <algorithm>

#include <gtest/gtest.h>

namespace gld {
namespace {

bool is_available(InstructionSet set) {
  const auto sets = available_instruction_sets();
  return std::find(sets.begin(), sets.end(), set) != sets.end();
}

TEST(InstructionSet, PortableKernelsAlwaysRun) { EXPECT_TRUE(is_available(InstructionSet::kPortable)); }

#ifdef __x86_64__
// A build without the wide kernels computes the same, several times slower: nothing else would notice.
TEST(InstructionSet, OffersWhatTheProcessorHas) {
  EXPECT_EQ(is_available(InstructionSet::kAvx2),
            __builtin_cpu_supports("avx2") != 0 && __builtin_cpu_supports("fma") != 0);
  EXPECT_EQ(is_available(InstructionSet::kAvx512),
            __builtin_cpu_supports("avx512f") != 0 && __builtin_cpu_supports("avx512dq") != 0);
}
#endif

}  // namespace
}  // namespace gld
