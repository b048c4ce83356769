#include "gld/report/run_folder.h"

#include "gld/base/atomic_file.h"
#include "gld/base/atomic_folder.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/option_differences.h"
#include "gld/base/printable_text.h"
#include "gld/report/shell_word.h"

#include <algorithm>
#include <cerrno>
#include <fstream>
#include <system_error>

#include <fcntl.h>
#include <unistd.h>

namespace gld {
namespace {

std::string configuration_header(const std::string& command) {
  return "# gld " + command + ": the options of this run, defaults included";
}

std::string first_line(const std::filesystem::path& file) {
  std::ifstream stream(file);
  std::string line;
  std::getline(stream, line);
  return line;
}

// A killed run leaves half-written files under temporary names, and one killed at once nothing else.
bool holds_nothing(const std::filesystem::path& folder) {
  std::error_code error;
  for (const auto& item : std::filesystem::directory_iterator(folder, error)) {
    if (process_of_temporary_name(item.path().filename().string()) == 0) return false;
  }
  return !error;
}

// Returns whether the journal is of a run that was killed as it began.
bool has_no_result(const RunJournal::Found& journal) {
  return std::none_of(journal.written.begin(), journal.written.end(), is_result_of_run);
}

// Nobody can write below a file, and not everybody into every folder.
void refuse_unwritable(const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::path there = std::filesystem::absolute(folder, error).lexically_normal();
  if (!there.has_filename()) there = there.parent_path();  // "runs/one/"
  while (!std::filesystem::exists(there, error) && there.has_relative_path()) there = there.parent_path();
  if (!std::filesystem::is_directory(there, error)) {
    fail({folder.string(), "a folder to write into", "the file " + there.string() + " on the way to it",
          "choose another --out"});
  }
  if (faccessat(AT_FDCWD, there.c_str(), W_OK | X_OK, AT_EACCESS) == 0) return;
  const std::string reason = std::generic_category().message(errno);
  fail({folder.string(), "a folder that can be written into", there.string() + " (" + reason + ")",
        "choose another --out, or change its permissions"});
}

std::filesystem::path made_folder(const std::filesystem::path& folder, const std::string& command,
                                  EarlierRun earlier) {
  check_run_folder(folder, command, earlier);
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) {
    fail({folder.string(), "to create the run folder", "an error: " + error.message(),
          "choose another --out"});
  }
  return folder;
}

}  // namespace

std::string command_of_run(const std::filesystem::path& folder) {
  const std::string line = first_line(folder / kRunConfiguration), before = "# gld ";
  const size_t end = line.find(": the options");
  if (line.rfind(before, 0) != 0 || end == std::string::npos) return {};
  return line.substr(before.size(), end - before.size());
}

std::string resume_command(const std::filesystem::path& folder) {
  const std::string command = command_of_run(folder);
  const bool resumes = command == "sample" || command == "eval" || command == "splat fit" ||
                       command == "splat pairs" || command.rfind("train ", 0) == 0;
  return "gld " + command + " --config " + shell_word((folder / kRunConfiguration).string()) + " --out " +
         shell_word(folder.string()) + (resumes ? " --resume" : " --overwrite");
}

EarlierRun earlier_run(bool overwrite) { return overwrite ? EarlierRun::kOverwrite : EarlierRun::kRefuse; }

void check_run_folder(const std::filesystem::path& folder, const std::string& command, EarlierRun earlier) {
  if (folder.empty()) {
    fail({"--out", "a folder to write into", "nothing", "add for example --out runs/" + command});
  }
  std::error_code error;
  if (std::filesystem::exists(folder, error) && !std::filesystem::is_directory(folder, error)) {
    fail({folder.string(), "a folder to write into", "a file", "choose another --out"});
  }
  refuse_unwritable(folder);
  if (!std::filesystem::exists(folder, error)) return;
  RunJournal::refuse_running(folder);
  if (holds_nothing(folder)) return;
  const std::string found = first_line(folder / kRunConfiguration);
  const auto journal = RunJournal::find(folder);
  // Killed before it wrote its configuration, a run has only begun.
  const bool begun = found.empty() && journal;
  if (!begun && found != configuration_header(command)) {
    const std::string other = command_of_run(folder);
    fail({folder.string(), "a new or empty folder",
          other.empty() ? "a folder with other files" : "a run of gld " + other, "choose another --out"});
  }
  if (earlier == EarlierRun::kContinue) return;
  if (earlier == EarlierRun::kRefuse) {
    if (journal && !RunJournal::has_earlier_aside(folder) && has_no_result(*journal)) return;
    fail({folder.string(), "a new or empty folder", "an earlier run of gld " + command,
          "choose another --out, or add --overwrite to remove what that run wrote"});
  }
  if (!journal || !journal->complete) {
    fail({folder.string(), "a run folder that says what the run wrote (.gld-run)",
          "one that a program of before did not note everything in",
          "remove the folder yourself or choose another --out"});
  }
}

RunFolder::RunFolder(const std::filesystem::path& folder, const std::string& command,
                     const OptionsGroup& options, EarlierRun earlier)
    : folder_(made_folder(folder, command, earlier)), journal_(folder_) {
  remove_abandoned_files(folder_);
  if (earlier == EarlierRun::kOverwrite) journal_.put_earlier_aside();
  write_file_atomically(folder_ / kRunConfiguration, configuration_header(command) + "\n" +
                                                         to_yaml_without(options, {"overwrite", "resume"}));
}

std::filesystem::path RunFolder::subfolder(const std::string& name) const {
  auto path = folder_ / name;
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
    lines.push_back(printable_text(what) + std::string(label - what.size() + 2, ' ') +
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
