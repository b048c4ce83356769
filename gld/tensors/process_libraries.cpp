#include "gld/tensors/process_libraries.h"

#include <link.h>

namespace gld {
namespace {

int collect_library(dl_phdr_info* info, size_t /*size*/, void* data) {
  if (info->dlpi_name != nullptr) static_cast<std::vector<std::string>*>(data)->emplace_back(info->dlpi_name);
  return 0;
}

}  // namespace

std::vector<std::string> loaded_libraries() {
  std::vector<std::string> paths;
  dl_iterate_phdr(collect_library, &paths);
  return paths;
}

std::vector<std::string> openmp_runtimes() {
  std::vector<std::string> found;
  for (const std::string& path : loaded_libraries()) {
    const std::string name = path.substr(path.rfind('/') + 1);
    // Older packages of PyTorch call theirs libgomp-HASH.so.1.
    for (const char* runtime : {"libgomp.", "libgomp-", "libomp.", "libomp-", "libiomp5."}) {
      if (name.rfind(runtime, 0) == 0) found.push_back(path);
    }
  }
  return found;
}

}  // namespace gld
