#pragma once

#include <torch/types.h>

#include <string>

// The only place that knows LibTorch versions (1.13 to 2.x).
namespace gld {

// "1.13.0", as the library itself reports it.
std::string torch_version();

// Which BLAS serves matrix products, as far as the library and the dynamic linker tell ("openblas", "mkl",
// "reference", ...).
std::string blas_name();

// One setting for LibTorch's own loops, OpenMP and BLAS (Debian's LibTorch starts with one thread).
void set_thread_count(int threads);
int thread_count();

}  // namespace gld
