#include "tests/support/shared_data.h"

#include "gld/base/error.h"

#include <cstdlib>
#include <stdexcept>

#include <gtest/gtest.h>

namespace gld::test {

std::filesystem::path source_root() { return GLD_SOURCE_DIR; }

std::filesystem::path shared_data() {
  const char* named = std::getenv("GLD_SHARED");
  const std::filesystem::path folder = named != nullptr ? named : source_root() / ".." / "shared";
  if (!std::filesystem::is_directory(folder / "goldens")) {
    throw std::runtime_error("the shared reference data was not found at " + folder.string() +
                             "; set GLD_SHARED to its folder");
  }
  return folder;
}

TemporaryFolder::TemporaryFolder() {
  std::string pattern = (std::filesystem::temp_directory_path() / "gld_test_").string();
  pattern += std::string(6, 'X');  // mkdtemp replaces these
  if (mkdtemp(pattern.data()) == nullptr) throw std::runtime_error("no temporary folder could be made");
  path_ = pattern;
}

TemporaryFolder::~TemporaryFolder() {
  std::error_code ignored;
  std::filesystem::remove_all(path_, ignored);
}

std::string error_of(const std::function<void()>& action) {
  try {
    action();
  } catch (const Error& error) {
    return error.what();
  }
  ADD_FAILURE() << "no error was thrown";
  return {};
}

}  // namespace gld::test
