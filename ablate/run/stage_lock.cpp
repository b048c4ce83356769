#include "ablate/run/stage_lock.h"

#include "gld/base/error.h"

#include <cerrno>
#include <cstring>
#include <string>

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

namespace gld {
namespace {

[[noreturn]] void refuse(const std::filesystem::path& file) {
  fail({file.string(), "a lock, which says that no other ablation works at the stage", std::strerror(errno),
        "give --cache a folder of your own, on a file system with locks"});
}

}  // namespace

StageLock::StageLock(const std::filesystem::path& folder)
    : path_(folder / "lock"), file_(::open(path_.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666)) {
  if (file_ < 0) refuse(path_);
}

StageLock::~StageLock() { ::close(file_); }

bool StageLock::take() const {
  if (::flock(file_, LOCK_EX | LOCK_NB) == 0) return true;
  if (errno != EWOULDBLOCK) refuse(path_);
  return false;
}

}  // namespace gld
