#include "gld/tensors/compute_threads.h"

#include "gld/base/command_options.h"
#include "gld/tensors/torch_version.h"

namespace gld {

int use_threads(int64_t threads) {
  const auto count = static_cast<int>(threads_to_use(threads));
  set_thread_count(count);
  return count;
}

std::vector<std::string> thread_warnings(int64_t threads) {
  const int64_t count = threads_to_use(threads), cores = threads_to_use(0);
  if (count <= cores) return {};
  return {std::to_string(count) + " threads share " + std::to_string(cores) + " core" +
          (cores == 1 ? "" : "s") + ", which makes them slower, not faster: lower --threads."};
}

}  // namespace gld
