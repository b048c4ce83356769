#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>

namespace gld {

// Bytes that somebody else owns.
struct ByteView {
  const uint8_t* data = nullptr;
  size_t size = 0;
};

// A whole file mapped into memory, copy on write: tensors that share the mapping may be written to, the file
// never changes. Only touched pages occupy memory.
class MappedFile {
 public:
  // Throws Error when the file does not exist, is a folder or cannot be read.
  static std::shared_ptr<const MappedFile> open(const std::filesystem::path& file);
  ~MappedFile();
  MappedFile(const MappedFile&) = delete;
  MappedFile& operator=(const MappedFile&) = delete;

  ByteView bytes() const { return {data_, size_}; }

  // Gives the whole pages among these bytes back to the system; the file is read again when they are touched. What was
  // written to them is lost. Bytes outside the mapping are left alone.
  void drop_pages(ByteView bytes) const;

 private:
  MappedFile() = default;
  uint8_t* data_ = nullptr;
  size_t size_ = 0;
};

}  // namespace gld
