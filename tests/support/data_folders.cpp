#include "tests/support/data_folders.h"

#include <cstdlib>
#include <stdexcept>

namespace gld::test {

std::filesystem::path source_root() { return GLD_SOURCE_DIR; }

std::filesystem::path test_data() { return source_root() / "tests" / "data"; }

std::filesystem::path shared_data() {
  const char* named = std::getenv("GLD_SHARED");
  std::filesystem::path folder = named != nullptr ? named : source_root() / ".." / "shared";
  if (!std::filesystem::is_directory(folder / "goldens")) {
    throw std::runtime_error("the shared reference data was not found at " + folder.string() +
                             "; set GLD_SHARED to its folder, or leave out the tests of the label shared");
  }
  return folder;
}

}  // namespace gld::test
