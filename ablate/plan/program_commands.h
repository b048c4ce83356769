#pragma once

#include "gld/base/options.h"

#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace gld {

// The program that stages are run by, as cli/ gives it: this one.
struct ProgramCommands {
  std::filesystem::path program;
  std::string version;  // with a hash of the executable: what another build made is not taken for this one's
  std::vector<std::string> names;  // "eval", "train level"
  // Returns the command's options with their defaults; null for one that has none or does not exist.
  std::function<std::shared_ptr<OptionsGroup>(const std::string& command)> options;
};

}  // namespace gld
