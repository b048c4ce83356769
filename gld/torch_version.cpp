#include "gld/torch_version.h"

#include <ATen/Parallel.h>
#include <dlfcn.h>
#include <link.h>
#include <torch/version.h>

#include <cstring>

namespace gld {
namespace {

int collect_blas(dl_phdr_info* info, size_t /*size*/, void* data) {
  auto* found = static_cast<std::string*>(data);
  const std::string path = info->dlpi_name == nullptr ? "" : info->dlpi_name;
  struct Pattern {
    const char* fragment;
    const char* name;
  };
  // libblas.so.3 is whatever Debian's alternatives point at, so the more specific names come first.
  for (const Pattern& pattern : {Pattern{"openblas", "openblas"}, Pattern{"blis", "blis"}, Pattern{"mkl", "mkl"},
                                 Pattern{"atlas", "atlas"}, Pattern{"/blas/", "reference"}}) {
    if (found->empty() && path.find(pattern.fragment) != std::string::npos) *found = pattern.name;
  }
  return 0;
}

}  // namespace

std::string torch_version() {
  return std::to_string(TORCH_VERSION_MAJOR) + "." + std::to_string(TORCH_VERSION_MINOR) + "." +
         std::to_string(TORCH_VERSION_PATCH);
}

std::string blas_name() {
  std::string found;
  dl_iterate_phdr(collect_blas, &found);
  return found.empty() ? "unknown" : found;
}

void set_thread_count(int threads) {
  at::set_num_threads(threads);
  // at::set_num_threads sets OpenMP and MKL; a BLAS with a pool of its own (OpenBLAS with pthreads) has to be told.
  using SetThreads = void (*)(int);
  for (const char* symbol : {"openblas_set_num_threads", "bli_thread_set_num_threads"}) {
    if (auto set = reinterpret_cast<SetThreads>(dlsym(RTLD_DEFAULT, symbol))) set(threads);
  }
}

int thread_count() { return at::get_num_threads(); }

}  // namespace gld
