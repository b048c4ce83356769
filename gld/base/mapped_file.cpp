#include "gld/base/mapped_file.h"

#include "gld/base/error.h"

#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

namespace gld {
namespace {

[[noreturn]] void fail_to_open(const std::filesystem::path& file) {
  fail({file.string(), "a readable file", std::strerror(errno), "check the path"});
}

class Descriptor {
 public:
  explicit Descriptor(int value) : value_(value) {}
  ~Descriptor() {
    if (value_ >= 0) ::close(value_);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  int value() const { return value_; }

 private:
  int value_;
};

}  // namespace

std::shared_ptr<const MappedFile> MappedFile::open(const std::filesystem::path& file) {
  // NONBLOCK is there because opening a pipe would otherwise wait for somebody who writes to it.
  const Descriptor descriptor(::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (descriptor.value() < 0) fail_to_open(file);
  struct stat status {};
  if (::fstat(descriptor.value(), &status) != 0) fail_to_open(file);
  if (!S_ISREG(status.st_mode)) {
    fail({file.string(), "a readable file", S_ISDIR(status.st_mode) ? "a folder" : "a special file",
          "check the path"});
  }
  std::shared_ptr<MappedFile> mapped(new MappedFile);
  mapped->size_ = static_cast<size_t>(status.st_size);
  if (mapped->size_ != 0) {
    // NORESERVE is there because a private writable mapping would otherwise be charged in full before anything is
    // written to it.
    void* address = ::mmap(nullptr, mapped->size_, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_NORESERVE,
                           descriptor.value(), 0);
    if (address == MAP_FAILED) fail_to_open(file);
    mapped->data_ = static_cast<uint8_t*>(address);
  }
  return mapped;
}

void MappedFile::drop_pages(ByteView bytes) const {
  // Addresses are compared as numbers: pointers into different objects have no order.
  const auto start = reinterpret_cast<uintptr_t>(bytes.data), mapped = reinterpret_cast<uintptr_t>(data_);
  if (start < mapped || start - mapped > size_ || bytes.size > size_ - (start - mapped)) return;
  const auto page = static_cast<uintptr_t>(::sysconf(_SC_PAGESIZE));
  const uintptr_t first = (start + page - 1) / page * page, last = (start + bytes.size) / page * page;
  if (first < last) ::madvise(data_ + (first - mapped), last - first, MADV_DONTNEED);
}

MappedFile::~MappedFile() {
  if (data_ != nullptr) ::munmap(data_, size_);
}

}  // namespace gld
