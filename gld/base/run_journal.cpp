#include "gld/base/run_journal.h"

#include "gld/base/error.h"
#include "gld/base/interrupted_end.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <mutex>
#include <set>

#include <fcntl.h>
#include <nlohmann/json.hpp>
#include <sys/file.h>
#include <unistd.h>

namespace gld {
namespace {

constexpr const char* kJournalName = ".gld-run";
constexpr const char* kEarlierRun = ".gld-earlier-run";
// The header is of fixed length, so that it is replaced in place: another name would lose the lock.
constexpr size_t kHeaderLength = 256;

std::string host_name() {
  std::array<char, 128> name{};
  if (::gethostname(name.data(), name.size() - 1) != 0) return "unknown";
  return name.data();
}

std::string header_text(bool running, bool complete) {
  const nlohmann::ordered_json header = {
      {"gld run", 1}, {"host", host_name()}, {"process", running ? ::getpid() : 0}, {"complete", complete}};
  std::string text = header.dump();
  text.resize(kHeaderLength - 1, ' ');
  return text + "\n";
}

// Returns an empty object for a damaged one.
nlohmann::json read_header(const std::filesystem::path& journal) {
  std::ifstream stream(journal);
  std::string line(kHeaderLength, '\0');
  stream.read(line.data(), kHeaderLength);
  line.resize(static_cast<size_t>(stream.gcount()));
  auto header = nlohmann::json::parse(line, nullptr, /*allow_exceptions=*/false);
  return header.is_object() ? header : nlohmann::json::object();
}

bool has_journal(const std::filesystem::path& folder) {
  std::error_code error;
  return std::filesystem::is_regular_file(folder / kJournalName, error);
}

// Some file systems cannot lock; there a second run is not noticed.
bool lock(int file) {
  if (::flock(file, LOCK_EX | LOCK_NB) == 0) return true;
  return errno != EWOULDBLOCK;
}

// Returns a name as a line of the journal: a JSON string, or the list of its bytes where they are no UTF-8, of which
// JSON knows nothing else.
std::string line_of(const std::string& name) {
  try {
    return nlohmann::json(name).dump();
  } catch (const nlohmann::json::type_error&) {
    return nlohmann::json(std::vector<uint8_t>(name.begin(), name.end())).dump();
  }
}

// Held while a journal or what is aside changes.
std::mutex& notes_mutex() {
  static std::mutex only;
  return only;
}

// Returns whether a noted name is of a file of the run: a damaged journal must reach neither outside nor itself, and
// what lies behind a symbolic link is somebody else's.
bool lies_below(const std::filesystem::path& folder, const std::filesystem::path& relative) {
  if (relative.is_absolute() || relative.empty()) return false;
  const auto first = *relative.begin();
  if (first == ".." || first == "." || first == kJournalName || first == kEarlierRun) return false;
  std::error_code error;
  for (auto above = relative.parent_path(); !above.empty(); above = above.parent_path()) {
    if (std::filesystem::is_symlink(folder / above, error)) return false;
  }
  return true;
}

void move_file(const std::filesystem::path& from, const std::filesystem::path& to) {
  std::error_code error;
  std::filesystem::create_directories(to.parent_path(), error);
  std::filesystem::rename(from, to, error);
  if (error) {
    fail({from.string(), "to move a file of the earlier run", "an error: " + error.message(),
          "check the folder's permissions or choose another --out"});
  }
}

// Returns nothing for a damaged line.
std::optional<std::string> noted_name(const std::string& line) {
  const auto value = nlohmann::json::parse(line, nullptr, /*allow_exceptions=*/false);
  if (value.is_string()) return value.get<std::string>();
  if (!value.is_array() || value.empty()) return std::nullopt;
  std::string name;
  for (const auto& byte : value) {
    if (!byte.is_number_unsigned() || byte.get<uint64_t>() > 255) return std::nullopt;
    name += static_cast<char>(byte.get<uint8_t>());
  }
  return name;
}

[[noreturn]] void fail_running(const std::filesystem::path& folder) {
  const auto header = read_header(folder / kJournalName);
  std::string writer = "one that another process is writing";
  if (header.contains("process") && header["process"].is_number_integer()) {
    writer += " (process " + std::to_string(header["process"].get<int64_t>()) + " on " +
              header.value("host", std::string("unknown")) + ")";
  }
  fail({folder.string(), "a run folder that no other process writes", writer,
        "wait for it or choose another --out"});
}

}  // namespace

bool is_result_of_run(const std::string& name) { return name != kRunConfiguration && name != kRunProgress; }

std::optional<RunJournal::Found> RunJournal::find(const std::filesystem::path& folder) {
  if (!has_journal(folder)) return std::nullopt;
  const auto header = read_header(folder / kJournalName);
  Found found;
  found.complete = header.contains("complete") && header["complete"] == true;
  std::ifstream stream(folder / kJournalName);
  stream.seekg(kHeaderLength);
  std::set<std::string> known;
  for (std::string line; std::getline(stream, line);) {
    const std::optional<std::string> name = noted_name(line);
    if (!name || !known.insert(*name).second) continue;
    std::error_code error;
    if (std::filesystem::exists(std::filesystem::symlink_status(folder / *name, error))) {
      found.written.push_back(*name);
    }
  }
  return found;
}

void RunJournal::refuse_running(const std::filesystem::path& folder) {
  const int file = ::open((folder / kJournalName).c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0) return;
  const bool locked = lock(file);
  ::close(file);
  if (!locked) fail_running(folder);
}

RunJournal::RunJournal(const std::filesystem::path& folder) : folder_(folder) {
  const auto found = find(folder);
  std::error_code error;
  complete_ = found ? found->complete : std::filesystem::is_empty(folder, error);
  file_ = ::open((folder / kJournalName).c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666);
  if (file_ < 0) {
    const std::string reason = std::strerror(errno);
    fail({(folder / kJournalName).string(), "a file that can be written", reason,
          "check the folder's permissions"});
  }
  if (!lock(file_)) {
    ::close(file_);
    fail_running(folder);
  }
  write_header(/*running=*/true);
  beginning_ = std::make_unique<UndoneAtEnd>([this] {
    // Another thread may be noting the first result, and then nothing is to be put back.
    const std::unique_lock<std::mutex> notes(notes_mutex(), std::try_to_lock);
    if (notes) put_earlier_back();
  });
}

RunJournal::~RunJournal() {
  try {
    const std::lock_guard<std::mutex> notes(notes_mutex());
    put_earlier_back();
    write_header(/*running=*/false);
  } catch (const std::exception&) {
    // A disk failed or there is no memory: what is aside stays there, and the journal goes on naming this process,
    // which a later one finds gone by the lock.
  }
  ::close(file_);  // releases the lock
}

void RunJournal::write_header(bool running) const {
  const std::string text = header_text(running, complete_);
  // A disk that is full will refuse the run's files too, with their names.
  if (::pwrite(file_, text.data(), text.size(), 0) < 0) return;
}

bool RunJournal::has_earlier_aside(const std::filesystem::path& folder) {
  std::error_code error;
  return std::filesystem::is_directory(std::filesystem::symlink_status(folder / kEarlierRun, error));
}

void RunJournal::put_earlier_aside() {
  const std::lock_guard<std::mutex> lock(notes_mutex());
  const auto aside = folder_ / kEarlierRun;
  std::set<std::filesystem::path> folders;
  std::error_code error;
  const auto found = find(folder_);
  if (!found) return;
  for (const auto& name : found->written) {
    const auto relative = std::filesystem::path(name).lexically_normal();
    if (!lies_below(folder_, relative)) continue;
    if (!std::filesystem::is_directory(std::filesystem::symlink_status(folder_ / relative, error))) {
      // One that was killed before its first result was beginning anew as well, and has a configuration only.
      if (std::filesystem::exists(std::filesystem::symlink_status(aside / relative, error))) {
        std::filesystem::remove(folder_ / relative, error);
      } else {
        move_file(folder_ / relative, aside / relative);
      }
    }
    for (auto above = relative.parent_path(); !above.empty(); above = above.parent_path()) {
      folders.insert(above);
    }
  }
  // Inner folders are removed first. Those that still hold something stay.
  std::vector<std::filesystem::path> inner_first(folders.begin(), folders.end());
  std::sort(inner_first.begin(), inner_first.end(), [](const auto& a, const auto& b) {
    return std::distance(a.begin(), a.end()) > std::distance(b.begin(), b.end());
  });
  for (const auto& folder : inner_first) std::filesystem::remove(folder_ / folder, error);
}

void RunJournal::put_earlier_back() const {
  if (!has_earlier_aside(folder_)) return;
  const auto aside = folder_ / kEarlierRun;
  std::error_code error;
  for (const char* name : {kRunConfiguration, kRunProgress}) {
    std::filesystem::remove(folder_ / name, error);  // of the run that came to nothing
  }
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(aside)) {
    if (!std::filesystem::is_directory(entry.symlink_status())) files.push_back(entry.path());
  }
  for (const auto& file : files) move_file(file, folder_ / file.lexically_relative(aside));
  std::filesystem::remove_all(aside, error);
}

namespace {

// The new run has its first result. The earlier one goes in one step, so that what is aside is whole or of no run.
void forget_earlier(const std::filesystem::path& folder) {
  const auto going = folder / (std::string(kEarlierRun) + ".partial-" + std::to_string(::getpid()) + "-0");
  std::error_code error;
  std::filesystem::remove_all(going, error);
  std::filesystem::rename(folder / kEarlierRun, going, error);
  if (error) {
    fail({(folder / kEarlierRun).string(), "to move the earlier run away", "an error: " + error.message(),
          "check the folder's permissions or choose another --out"});
  }
  std::filesystem::remove_all(going, error);
  // Its notes go too, or they would tell the next run of files of those names that somebody else has put there.
  std::string lines;
  const auto left = RunJournal::find(folder);
  if (!left) return;
  for (const auto& name : left->written) lines += line_of(name) + "\n";
  const int journal = ::open((folder / kJournalName).c_str(), O_WRONLY | O_CLOEXEC);
  if (journal < 0) return;
  const auto written = ::pwrite(journal, lines.data(), lines.size(), kHeaderLength);
  const bool shortened = written == static_cast<ssize_t>(lines.size()) &&
                         ::ftruncate(journal, static_cast<off_t>(kHeaderLength + lines.size())) == 0;
  ::close(journal);
  if (!shortened) {
    fail({(folder / kJournalName).string(), "to be shortened", std::strerror(errno), "check the disk"});
  }
}

}  // namespace

void note_written(const std::filesystem::path& file) {
  std::error_code error;
  const auto target = std::filesystem::absolute(file, error).lexically_normal();
  if (error) return;
  auto folder = target.parent_path();
  while (!has_journal(folder)) {
    if (folder == folder.parent_path()) return;
    folder = folder.parent_path();
  }
  const auto header = read_header(folder / kJournalName);
  if (header.value("process", nlohmann::json()) != ::getpid() ||
      header.value("host", nlohmann::json()) != host_name()) {
    return;  // an earlier run's folder, into which this process puts something of its own
  }
  const std::string name = target.lexically_relative(folder).string();
  const std::string line = line_of(name) + "\n";
  const int journal = ::open((folder / kJournalName).c_str(), O_WRONLY | O_APPEND | O_CLOEXEC);
  if (journal < 0) return;
  // The header of a killed run may name a process of the same number; only one that runs holds the lock.
  if (::flock(journal, LOCK_EX | LOCK_NB) == 0) {
    ::close(journal);
    return;
  }
  const std::lock_guard<std::mutex> lock(notes_mutex());
  if (is_result_of_run(name) && RunJournal::has_earlier_aside(folder)) forget_earlier(folder);
  // What is written again and again, progress.json for one, is noted once.
  if (std::filesystem::exists(target, error)) {
    const auto noted = RunJournal::find(folder);
    if (noted && std::find(noted->written.begin(), noted->written.end(), name) != noted->written.end()) {
      ::close(journal);
      return;
    }
  }
  const auto written = ::write(journal, line.data(), line.size());  // one call: lines of threads do not mix
  ::close(journal);
  if (written != static_cast<ssize_t>(line.size())) {
    fail({(folder / kJournalName).string(), "to note " + target.string(), "a write that failed",
          "free some space or check the folder's permissions"});
  }
}

}  // namespace gld
