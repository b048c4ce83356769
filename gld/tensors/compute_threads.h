#pragma once

#include <cstdint>

namespace gld {

// What --threads asks for (gld/base/command_options.h; 0: one a core), set for LibTorch, OpenMP and BLAS alike. Returns
// the number of threads. The one way from an option to the setting.
int use_threads(int64_t threads);

}  // namespace gld
