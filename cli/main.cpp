#include "cli/command.h"
#include "cli/commands.h"
#include "gld/tensors/torch_version.h"

#include <cstdint>
#include <string>
#include <vector>

namespace {

// Enough for the temporaries of one full-size block; weights are mapped and need none of it.
constexpr int64_t kMostKeptBytes = int64_t{2} << 30;

}  // namespace

int main(int argc, char** argv) {
  const std::vector<std::string> arguments(argv + 1, argv + argc);
  gld::keep_freed_tensor_memory(kMostKeptBytes);
  return gld::run_command_line(gld::all_commands(), arguments);
}
