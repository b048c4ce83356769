#pragma once

#include "gld/kernels/kernel_table.h"

// What each kernels_*.cpp defines; use kernel_table() instead.
namespace gld {

const KernelTable& portable_kernels();
const KernelTable& avx2_kernels();
const KernelTable& avx512_kernels();

}  // namespace gld
