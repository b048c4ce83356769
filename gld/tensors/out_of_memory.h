#pragma once

#include <c10/util/Exception.h>

namespace gld {

// Returns whether what LibTorch threw says that the CPU or a GPU has no memory for a tensor. Its class for that is
// younger than the oldest LibTorch here, and not the CPU's.
bool is_out_of_memory(const c10::Error& error);

}  // namespace gld
