#include "gld/base/mapped_file.h"

#include "gld/base/atomic_file.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <cstdint>
#include <memory>
#include <string>

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

namespace gld {
namespace {

constexpr size_t kPages = 8;

// A file of kPages pages, every byte of page i is 'a' + i.
class MappedPages : public testing::Test {
 protected:
  MappedPages() : page_(static_cast<size_t>(::sysconf(_SC_PAGESIZE))) {
    std::string text;
    for (size_t i = 0; i < kPages; ++i) text += std::string(page_, static_cast<char>('a' + i));
    const auto path = folder_.path() / "pages";
    write_file_atomically(path, text);
    file_ = MappedFile::open(path);
  }

  uint8_t* page(size_t i) const { return const_cast<uint8_t*>(file_->bytes().data) + i * page_; }

  // Touches every page, drops the bytes from the one offset to the other and returns which pages are left.
  std::string left_after_dropping(size_t from, size_t to) {
    for (size_t i = 0; i < kPages; ++i)
      page(i)[0] = 'x';  // a copy of its own, so that the page cache does not count
    file_->drop_pages({file_->bytes().data + from, to - from});
    std::string left;
    for (size_t i = 0; i < kPages; ++i) left += page(i)[0] == 'x' ? '1' : '0';
    return left;
  }

  test::TemporaryFolder folder_;
  size_t page_;
  std::shared_ptr<const MappedFile> file_;
};

TEST_F(MappedPages, DropsOnlyPagesThatLieWhollyInside) {
  EXPECT_EQ(left_after_dropping(2 * page_, 5 * page_), "11000111");
  EXPECT_EQ(left_after_dropping(2 * page_ + 1, 5 * page_ - 1), "11101111");
  EXPECT_EQ(left_after_dropping(2 * page_ + 1, 3 * page_ - 1), "11111111");
  EXPECT_EQ(left_after_dropping(0, kPages * page_), "00000000");
}

TEST_F(MappedPages, ReadsTheFileAgainWhereItWasDropped) {
  left_after_dropping(page_, 2 * page_);
  EXPECT_EQ(page(1)[0], 'b');
  EXPECT_EQ(page(1)[page_ - 1], 'b');
}

TEST_F(MappedPages, RefusesAPipeWithoutWaitingForAWriter) {
  const auto pipe = folder_.path() / "pipe";
  ASSERT_EQ(::mkfifo(pipe.c_str(), 0600), 0);
  EXPECT_EQ(test::error_of([&] { MappedFile::open(pipe); }),
            pipe.string() + ": expected a readable file, found a special file; check the path.");
}

TEST_F(MappedPages, LeavesOtherMemoryAlone) {
  std::string other(3 * page_, 'o');
  file_->drop_pages({reinterpret_cast<const uint8_t*>(other.data()), other.size()});
  EXPECT_EQ(other, std::string(3 * page_, 'o'));
  // Past the end of the mapping.
  EXPECT_EQ(left_after_dropping(page_, (kPages + 1) * page_), "11111111");
}

}  // namespace
}  // namespace gld
