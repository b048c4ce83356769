#pragma once

#include "gld/base/options.h"

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// The folder a command writes into: the resolved configuration first, then results, report.json and a closing
// box that says where things are (DESIGN.md section 5).
class RunFolder {
 public:
  // Creates the folder and writes config.yaml. An existing folder is taken when it is empty or an earlier run
  // of the same command (its config.yaml says so); anything else is refused, so that nothing of the user's is
  // overwritten.
  RunFolder(std::filesystem::path folder, const std::string& command, const OptionsGroup& options);

  const std::filesystem::path& path() const { return folder_; }
  // A sub-folder, created when missing.
  std::filesystem::path subfolder(const std::string& name) const;

  void write_report(const nlohmann::ordered_json& report) const;

  // A line of the closing box: what it is and where, relative to the folder.
  void note(const std::string& what, const std::string& where);
  // The box as text, for standard output.
  std::string closing_box() const;

 private:
  std::filesystem::path folder_;
  std::vector<std::pair<std::string, std::string>> notes_;
};

}  // namespace gld
