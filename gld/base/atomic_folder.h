#pragma once

#include "gld/base/interrupt.h"

#include <filesystem>
#include <optional>
#include <string>

namespace gld {

// A folder that appears whole or not at all: filled below a hidden folder beside its place and renamed. Nothing is
// replaced but an empty folder. Without commit() nothing is left.
class AtomicFolder {
 public:
  // The parent must exist, and under the target's name nothing or an empty folder; throws Error otherwise.
  explicit AtomicFolder(std::filesystem::path target);
  ~AtomicFolder();
  AtomicFolder(const AtomicFolder&) = delete;
  AtomicFolder& operator=(const AtomicFolder&) = delete;

  // Returns where to write before commit(): the folder exists and has the target's own name, which some formats write
  // into their files.
  const std::filesystem::path& temporary() const { return temporary_; }
  void commit();

 private:
  std::filesystem::path target_;
  std::filesystem::path holder_;  // hidden; holds temporary_
  std::filesystem::path temporary_;
  std::optional<Unfinished> unfinished_;
};

// Makes a copy that appears whole or not at all.
void copy_file_atomically(const std::filesystem::path& from, const std::filesystem::path& to);

// Removes what AtomicFile and AtomicFolder of killed processes left in a folder and below it: temporary names with the
// number of a process that runs no more, or of this one (numbers are used again). It is only for folders that no other
// thread writes to. Links are not followed, nor folders of other runs below; what cannot be removed stays.
void remove_abandoned_files(const std::filesystem::path& folder);

// Returns the number of the process in a temporary name ("12" in ".model.partial-12-0.safetensors"), and 0 when it is
// another name.
long process_of_temporary_name(const std::string& name);

}  // namespace gld
