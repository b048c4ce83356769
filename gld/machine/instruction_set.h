#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// The vector instruction sets our kernels exist for, in order of width.
enum class InstructionSet { kPortable, kAvx2, kAvx512 };

// Returns what this processor can run and this build contains, widest last; it is never empty (the portable kernels
// always work).
std::vector<InstructionSet> available_instruction_sets();
// Returns the widest of them.
InstructionSet best_instruction_set();

// Returns the bytes of the second-level cache of a core, and 256 KiB where the system does not say.
int64_t second_level_cache_bytes();

// Returns "portable", "AVX2" or "AVX-512".
std::string instruction_set_name(InstructionSet set);

}  // namespace gld
