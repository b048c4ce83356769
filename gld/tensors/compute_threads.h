#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// Sets what --threads asks for (gld/base/command_options.h; 0: one a core) for LibTorch, OpenMP and BLAS alike.
// Returns the number of threads. This is the one way from an option to the setting.
int use_threads(int64_t threads);

// Returns warnings about that choice: none, or that the threads are more than the cores. 4096 threads on 2 cores take
// minutes for what one does in a second.
std::vector<std::string> thread_warnings(int64_t threads);

}  // namespace gld
