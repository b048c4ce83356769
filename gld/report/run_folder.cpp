#include "gld/report/run_folder.h"

#include "gld/base/atomic_file.h"
#include "gld/base/atomic_folder.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/printable_text.h"

#include <algorithm>
#include <fstream>

namespace gld {
namespace {

std::string first_line(const std::filesystem::path& file) {
  std::ifstream stream(file);
  std::string line;
  std::getline(stream, line);
  return line;
}

}  // namespace

RunFolder::RunFolder(std::filesystem::path folder, const std::string& command, const OptionsGroup& options)
    : folder_(std::move(folder)) {
  if (folder_.empty()) {
    fail({"--out", "a folder to write into", "nothing", "add for example --out runs/" + command});
  }
  const std::string header = "# gld " + command + ": the options of this run, defaults included";
  std::error_code error;
  if (std::filesystem::exists(folder_, error)) {
    if (!std::filesystem::is_directory(folder_, error)) {
      fail({folder_.string(), "a folder to write into", "a file", "choose another --out"});
    }
    // A killed run leaves half-written files under temporary names, and one killed at once nothing else.
    remove_abandoned_files(folder_);
    if (!std::filesystem::is_empty(folder_, error) && first_line(folder_ / "config.yaml") != header) {
      fail({folder_.string(), "an empty folder or an earlier run of gld " + command,
            "a folder with other files", "choose another --out"});
    }
  } else if (!std::filesystem::create_directories(folder_, error)) {
    fail({folder_.string(), "to create the run folder", "an error: " + error.message(),
          "choose another --out"});
  }
  write_file_atomically(folder_ / "config.yaml", header + "\n" + to_yaml(options));
}

std::filesystem::path RunFolder::subfolder(const std::string& name) const {
  const auto path = folder_ / name;
  std::error_code error;
  std::filesystem::create_directories(path, error);
  if (error)
    fail({path.string(), "to create a folder", "an error: " + error.message(), "check its permissions"});
  return path;
}

void RunFolder::write_report(const nlohmann::ordered_json& report) const {
  write_file_atomically(folder_ / "report.json", json_text(report, 2) + "\n");
}

void RunFolder::note(const std::string& what, const std::string& where) { notes_.emplace_back(what, where); }

std::string RunFolder::closing_box() const {
  std::vector<std::string> lines;
  size_t label = 0;
  for (const auto& [what, where] : notes_) label = std::max(label, what.size());
  for (const auto& [what, where] : notes_) {
    lines.push_back(what + std::string(label - what.size() + 2, ' ') +
                    printable_text((folder_ / where).string()));
  }
  size_t width = 0;
  for (const auto& line : lines) width = std::max(width, line.size());
  const std::string rule = "+" + std::string(width + 2, '-') + "+\n";
  std::string box = rule;
  for (const auto& line : lines) box += "| " + line + std::string(width - line.size(), ' ') + " |\n";
  return box + rule;
}

}  // namespace gld
