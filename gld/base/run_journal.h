#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace gld {

class UndoneAtEnd;

// What every run writes first, and how far it is (gld/report/progress.h). They are no results.
inline constexpr const char* kRunConfiguration = "config.yaml";
inline constexpr const char* kRunProgress = "progress.json";
bool is_result_of_run(const std::string& name);

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

  // For a run that begins anew: moves every file that is noted into a hidden folder below, and removes folders that are
  // empty for it. Nothing else is touched, and no symbolic link is followed. The first result that is noted afterwards
  // (is_result_of_run) is the new run's: with it the earlier run goes for good. Where this object
  // goes before that, or a stop ends the process, the earlier run is put back; where the process is killed, the next
  // run that is to begin anew finds it aside and keeps it so. Throws Error where a file cannot be moved.
  void put_earlier_aside();
  // Returns whether a folder has an earlier run aside.
  static bool has_earlier_aside(const std::filesystem::path& folder);

 private:
  void write_header(bool running) const;
  void put_earlier_back() const;  // with notes_mutex() held

  std::filesystem::path folder_;
  int file_ = -1;
  bool complete_ = true;
  std::unique_ptr<UndoneAtEnd> beginning_;  // puts back what is aside
};

// Notes the file in the journal of the nearest folder above it, where this process has one open there.
void note_written(const std::filesystem::path& file);

}  // namespace gld
