#pragma once

#include <filesystem>

namespace gld {

// The lock of a stage's folder: that no other ablation works at it. It is held by this process and by that of the
// stage's own command, until both have ended.
class StageLock {
 public:
  // Throws Error where its file cannot be opened, for want of rights or space.
  explicit StageLock(const std::filesystem::path& folder);
  ~StageLock();
  StageLock(const StageLock&) = delete;
  StageLock& operator=(const StageLock&) = delete;
  // Returns false where another one has it. Throws Error where the file system gives no locks.
  bool take() const;
  int file() const { return file_; }

 private:
  std::filesystem::path path_;
  int file_;
};

}  // namespace gld
