#pragma once

#include <string>
#include <vector>

// Which shared libraries this process runs on.
namespace gld {

// Returns their paths, in the order in which they were loaded.
std::vector<std::string> loaded_libraries();

// Returns the paths of the OpenMP runtimes among them (libgomp, libomp, libiomp5). LibTorch and our kernels must share
// one: two have a pool of threads each, which wait for each other's cores.
std::vector<std::string> openmp_runtimes();

}  // namespace gld
