#include "gld/base/atomic_file.h"

#include "gld/base/error.h"
#include "gld/base/run_journal.h"

#include <atomic>
#include <cerrno>
#include <cstring>
#include <fstream>

#include <fcntl.h>
#include <unistd.h>

namespace gld {
namespace {

std::string system_reason() { return std::strerror(errno); }

std::filesystem::path temporary_name(const std::filesystem::path& target) {
  static std::atomic<uint64_t> counter{0};  // two writers of one process must not share a name
  const std::string name = "." + target.stem().string() + ".partial-" + std::to_string(::getpid()) + "-" +
                           std::to_string(counter.fetch_add(1)) + target.extension().string();
  return target.parent_path() / name;
}

}  // namespace

AtomicFile::AtomicFile(std::filesystem::path target)
    : target_(std::move(target)), temporary_(temporary_name(target_)), unfinished_(temporary_) {
  const auto folder = target_.parent_path().empty() ? std::filesystem::path(".") : target_.parent_path();
  std::error_code error;
  if (!std::filesystem::is_directory(folder, error)) {
    fail({target_.string(), "an existing folder to write into", "no folder " + folder.string(),
          "create it or choose another output"});
  }
}

AtomicFile::~AtomicFile() {
  if (committed_) return;
  std::error_code ignored;
  std::filesystem::remove(temporary_, ignored);
}

void AtomicFile::commit() {
  // Without the sync a crash after the rename could leave an empty file under the final name.
  const int file = ::open(temporary_.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0) {
    fail({target_.string(), "a finished file to rename", "an error: " + system_reason(), "check the disk"});
  }
  const int synced = ::fsync(file);
  ::close(file);
  if (synced != 0 && errno != EINVAL) {
    fail({target_.string(), "the file to reach the disk", "an error: " + system_reason(),
          "free some space or choose another disk"});
  }
  note_written(target_);  // before it is there: killed in between, a note too many does no harm
  std::error_code error;
  std::filesystem::rename(temporary_, target_, error);
  if (error) {
    fail({target_.string(), "to rename the finished file", "an error: " + error.message(),
          "check the folder's permissions"});
  }
  committed_ = true;
}

void write_file_atomically(const std::filesystem::path& target, const std::string& bytes) {
  AtomicFile file(target);
  {
    std::ofstream stream(file.temporary(), std::ios::binary | std::ios::trunc);
    stream.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    stream.flush();
    if (!stream) {
      fail({target.string(), "to write " + std::to_string(bytes.size()) + " bytes",
            "an error: " + system_reason(), "free some space or check the folder's permissions"});
    }
  }
  file.commit();
}

std::string read_file(const std::filesystem::path& file, uint64_t limit) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(file, error)) {
    fail({file.string(), "a file",
          std::filesystem::exists(file, error) ? "something that is no file" : "nothing", "check the path"});
  }
  // The size is taken of what is open: the name may stand for a newer file by then, since writers rename.
  std::ifstream stream(file, std::ios::binary | std::ios::ate);
  const auto end = stream ? static_cast<std::streamoff>(stream.tellg()) : std::streamoff{-1};
  if (end < 0)
    fail({file.string(), "a file that can be read", "an error: " + system_reason(), "check the permissions"});
  const auto size = static_cast<uint64_t>(end);
  if (size > limit) {
    fail({file.string(), "at most " + std::to_string(limit) + " bytes", std::to_string(size) + " bytes",
          "check that it is the right file"});
  }
  std::string bytes(size, '\0');
  stream.seekg(0);
  stream.read(bytes.data(), static_cast<std::streamsize>(size));
  if (!stream || static_cast<uint64_t>(stream.gcount()) != size) {
    fail({file.string(), "to read " + std::to_string(size) + " bytes", std::to_string(stream.gcount()),
          "check the disk and the permissions"});
  }
  return bytes;
}

}  // namespace gld
