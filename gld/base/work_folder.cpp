#include "gld/base/work_folder.h"

#include "gld/base/error.h"

#include <cstdlib>
#include <sstream>
#include <system_error>

#include <unistd.h>

namespace gld {

WorkFolder::WorkFolder(const std::string& name) : name_(name) {
  std::error_code error;
  const auto temporary = std::filesystem::temp_directory_path(error);
  std::string place = (temporary / ("gld-" + name + "-XXXXXX")).string();
  if (error || ::mkdtemp(place.data()) == nullptr) {
    fail({place, "a folder for what " + name + " reads and writes", "none could be made",
          "check the temporary folder ($TMPDIR)"});
  }
  path_ = place;
  unfinished_ = std::make_unique<Unfinished>(path_);
}

WorkFolder::~WorkFolder() {
  std::error_code ignored;
  if (unfinished_) std::filesystem::remove_all(path_, ignored);
}

std::filesystem::path found_program(const std::string& name) {
  const char* folders = std::getenv("PATH");
  std::istringstream list(folders == nullptr ? "" : folders);
  for (std::string folder; std::getline(list, folder, ':');) {
    if (folder.empty()) continue;
    auto program = std::filesystem::absolute(std::filesystem::path(folder) / name);
    if (std::filesystem::is_regular_file(program) && ::access(program.c_str(), X_OK) == 0) return program;
  }
  return {};
}

}  // namespace gld
