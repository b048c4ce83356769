#include "gld/base/error.h"
#include "gld/distributed/process_team.h"
#include "gld/tensors/torch_version.h"

// Where LibTorch comes without the headers of Gloo (cmake/GldLibTorch.cmake).
namespace gld {

std::vector<std::string> process_engines() { return {}; }

std::unique_ptr<ProcessTeam> join_processes(const ProcessPlacement& placement) {
  fail({"--processes.count",
        "1, for this build with LibTorch " + torch_version() + " has no engine for several processes",
        std::to_string(placement.count),
        "use a build with Debian's LibTorch and libgloo-dev (scripts/setup.sh)"});
}

}  // namespace gld
