#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace gld {

// What a run has written into its folder, noted in the folder while it runs, so that a later run can remove exactly
// that; and the lock that keeps a second run out. The file is .gld-run: a line about the process that writes, then a
// line a file. It survives a killed process, and is never removed, because another process may be waiting with it open.
class RunJournal {
 public:
  // What is known of the run that began in a folder, whatever became of it; none without a journal.
  struct Found {
    bool complete = true;              // every file of the run is noted
    std::vector<std::string> written;  // what is left of it, relative to the folder, in the order of writing
  };
  static std::optional<Found> find(const std::filesystem::path& folder);
  // Throws Error where another process, or another RunJournal of this one, has the folder's journal open.
  static void refuse_running(const std::filesystem::path& folder);

  // Opens or makes the folder's journal and locks it until this object goes. Throws the Error of refuse_running(), or
  // where it cannot be written. A folder that holds something else by then is taken for one that a run wrote into
  // without a journal, so that what is noted is not everything. From here on every AtomicFile of this process that is
  // committed below the folder is noted.
  explicit RunJournal(const std::filesystem::path& folder);
  ~RunJournal();
  RunJournal(const RunJournal&) = delete;
  RunJournal& operator=(const RunJournal&) = delete;

  // Removes every file that is noted, then the folders below that are empty for it, and forgets them. Nothing else is
  // touched.
  void remove_written();

 private:
  void write_header(bool running) const;

  std::filesystem::path folder_;
  int file_ = -1;
  bool complete_ = true;
};

// Notes the file in the journal of the nearest folder above it, where this process has one open there.
void note_written(const std::filesystem::path& file);

}  // namespace gld
