#pragma once

#include "gld/base/interrupt.h"

#include <cstdint>
#include <filesystem>
#include <string>

namespace gld {

// A file that appears whole or not at all: written under a temporary name in the same folder, synchronised to
// disk and renamed. Without commit() the temporary file is removed.
class AtomicFile {
 public:
  // Throws Error when the folder does not exist or cannot be written.
  explicit AtomicFile(std::filesystem::path target);
  ~AtomicFile();
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;

  // Returns where to write before commit(). It keeps the target's extension, which image libraries go by.
  const std::filesystem::path& temporary() const { return temporary_; }
  void commit();

 private:
  std::filesystem::path target_;
  std::filesystem::path temporary_;
  Unfinished unfinished_;
  bool committed_ = false;
};

void write_file_atomically(const std::filesystem::path& target, const std::string& bytes);

// Returns the whole file; throws Error when it cannot be read or is larger than limit bytes.
std::string read_file(const std::filesystem::path& file, uint64_t limit = uint64_t{1} << 32);

}  // namespace gld
