#pragma once

#include <cstdint>

namespace gld::test {

// LibTorch's meta device holds shapes without numbers, and a tensor that was left on the CPU is an error there as it
// would be on a GPU. A test that is linked with this file has kernels for what the device lacks outside Python, and may
// read numbers from it: every one is 1 (true). With that whole commands run there (device_from_text takes "meta").

// Returns how often the host has waited for the device so far: for numbers and tensors that were read from it.
int64_t meta_reads();

}  // namespace gld::test
