#pragma once

#include "gld/base/options.h"
#include "gld/base/run_journal.h"

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// What becomes of a run that is in the folder already.
enum class EarlierRun {
  kRefuse,
  // What it wrote is removed, and nothing else, with the first result of the new run; where that comes to none, what
  // the earlier run wrote is put back (RunJournal::put_earlier_aside).
  kOverwrite,
  kContinue,
};
// Of a command that has --overwrite and cannot go on with a run.
EarlierRun earlier_run(bool overwrite);

// Returns the command of the run that is in a folder, finished or not, "sample"; it is empty where there is none.
std::string command_of_run(const std::filesystem::path& folder);

// Returns what goes on with the run in a folder, or begins it anew where its command has no --resume: a line for a
// shell.
std::string resume_command(const std::filesystem::path& folder);

// Throws Error where RunFolder of the same arguments would, as far as that can be told beforehand. It touches nothing:
// it is for commands that have something long to do before they write.
void check_run_folder(const std::filesystem::path& folder, const std::string& command, EarlierRun earlier);

// The folder a command writes into: the resolved configuration first, then results, report.json and a closing
// box that says where things are (DESIGN.md section 5). As long as it is open no other run can write there; where
// several processes work at one run, one of them opens it for all.
class RunFolder {
 public:
  // Creates the folder and writes config.yaml, without the options that say what becomes of an earlier run. A folder
  // that holds something is refused unless it is a run of the same command, for which `earlier` says what to do; one
  // that was killed before it had a result may begin again.
  RunFolder(const std::filesystem::path& folder, const std::string& command, const OptionsGroup& options,
            EarlierRun earlier);

  const std::filesystem::path& path() const { return folder_; }
  // Returns a sub-folder, created when missing.
  std::filesystem::path subfolder(const std::string& name) const;

  void write_report(const nlohmann::ordered_json& report) const;

  // Adds a line of the closing box: what it is and where, relative to the folder.
  void note(const std::string& what, const std::string& where);
  // Returns the box as text, for standard output.
  std::string closing_box() const;

 private:
  std::filesystem::path folder_;
  RunJournal journal_;
  std::vector<std::pair<std::string, std::string>> notes_;
};

}  // namespace gld
