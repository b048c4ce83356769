#include "gld/tensors/compute_threads.h"

#include "gld/base/command_options.h"
#include "gld/tensors/torch_version.h"

namespace gld {

int use_threads(int64_t threads) {
  const auto count = static_cast<int>(threads_to_use(threads));
  set_thread_count(count);
  return count;
}

}  // namespace gld
