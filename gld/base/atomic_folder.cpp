#include "gld/base/atomic_folder.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/run_journal.h"

#include <atomic>
#include <cerrno>
#include <charconv>
#include <system_error>
#include <vector>

#include <fcntl.h>
#include <signal.h>
#include <unistd.h>

namespace gld {
namespace {

const std::string kMark = ".partial-";

void require(const std::error_code& error, const std::filesystem::path& path, const std::string& expected) {
  if (!error) return;
  fail({path.string(), expected, "an error: " + error.message(),
        "check the folder's permissions and the disk"});
}

struct OpenFile {
  explicit OpenFile(int opened) : number(opened) {}
  ~OpenFile() {
    if (number >= 0) ::close(number);
  }
  OpenFile(const OpenFile&) = delete;
  OpenFile& operator=(const OpenFile&) = delete;
  int number;
};

bool runs(long process) { return ::kill(static_cast<pid_t>(process), 0) == 0 || errno == EPERM; }

}  // namespace

AtomicFolder::AtomicFolder(std::filesystem::path target) : target_(std::move(target)) {
  static std::atomic<uint64_t> counter{0};  // two folders of one process must not share a name
  target_ = std::filesystem::absolute(target_).lexically_normal();
  if (!target_.has_filename()) target_ = target_.parent_path();  // "scene/"
  const std::string name = target_.filename().string();
  holder_ = target_.parent_path() /
            ("." + name + kMark + std::to_string(::getpid()) + "-" + std::to_string(counter.fetch_add(1)));
  temporary_ = holder_ / name;
  std::error_code error;
  if (!std::filesystem::is_directory(target_.parent_path(), error)) {
    fail({target_.string(), "an existing folder to write into", "no folder " + target_.parent_path().string(),
          "create it or choose another output"});
  }
  if (std::filesystem::exists(std::filesystem::symlink_status(target_, error)) &&
      !(std::filesystem::is_directory(target_, error) && std::filesystem::is_empty(target_, error))) {
    fail({target_.string(), "a new or empty folder", "one with other files",
          "move them or choose another output"});
  }
  unfinished_.emplace(holder_);
  std::filesystem::create_directories(temporary_, error);
  require(error, target_, "to create a folder");
}

AtomicFolder::~AtomicFolder() {
  std::error_code ignored;
  std::filesystem::remove_all(holder_, ignored);
}

void AtomicFolder::commit() {
  // The run that writes it knows the files by their final names; they are noted before they are there, as for single
  // files.
  for (const auto& entry : std::filesystem::recursive_directory_iterator(temporary_)) {
    if (!entry.is_directory()) note_written(target_ / entry.path().lexically_relative(temporary_));
  }
  std::error_code error;
  std::filesystem::rename(temporary_, target_, error);  // onto an empty folder too
  require(error, target_, "to rename the finished folder");
}

void copy_file_atomically(const std::filesystem::path& from, const std::filesystem::path& to) {
  AtomicFile file(to);
  // The bytes are not copied by std::filesystem, which says EIO where the disk is full.
  const OpenFile source(::open(from.c_str(), O_RDONLY | O_CLOEXEC));
  const OpenFile target(::open(file.temporary().c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666));
  const auto require_done = [&](bool done) {
    require(done ? std::error_code() : std::error_code(errno, std::generic_category()), to,
            "a copy of " + from.string());
  };
  require_done(source.number >= 0 && target.number >= 0);
  std::vector<char> bytes(size_t{1} << 20);
  for (ssize_t count = 0; (count = ::read(source.number, bytes.data(), bytes.size())) != 0;) {
    require_done(count > 0);
    for (ssize_t written = 0; written < count;) {
      const ssize_t now =
          ::write(target.number, bytes.data() + written, static_cast<size_t>(count - written));
      require_done(now > 0);
      written += now;
    }
  }
  file.commit();
}

long process_of_temporary_name(const std::string& name) {
  if (name.empty() || name.front() != '.') return 0;
  const size_t mark = name.rfind(kMark);
  if (mark == std::string::npos) return 0;
  const char* const end = name.data() + name.size();
  long process = 0;
  uint64_t count = 0;
  const auto first = std::from_chars(name.data() + mark + kMark.size(), end, process);
  if (first.ec != std::errc() || process <= 0 || first.ptr == end || *first.ptr != '-') return 0;
  const auto second = std::from_chars(first.ptr + 1, end, count);
  const bool whole = second.ec == std::errc() && (second.ptr == end || *second.ptr == '.');
  return whole ? process : 0;
}

void remove_abandoned_files(const std::filesystem::path& folder) {
  std::vector<std::filesystem::path> abandoned;
  std::error_code error;
  using Iterator = std::filesystem::recursive_directory_iterator;
  for (Iterator item(folder, std::filesystem::directory_options::skip_permission_denied, error), end;
       !error && item != end; item.increment(error)) {
    const long process = process_of_temporary_name(item->path().filename().string());
    if (process == 0) {
      if (RunJournal::find(item->path())) item.disable_recursion_pending();
      continue;
    }
    item.disable_recursion_pending();
    if (process == ::getpid() || !runs(process)) abandoned.push_back(item->path());
  }
  for (const auto& path : abandoned) {
    std::error_code ignored;
    std::filesystem::remove_all(path, ignored);
  }
}

}  // namespace gld
