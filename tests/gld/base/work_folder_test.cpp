#include "gld/base/work_folder.h"

#include "gld/base/atomic_file.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <cstdlib>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::TemporaryFolder;
using ::testing::HasSubstr;

// An environment variable that is as before at the end.
class Variable {
 public:
  Variable(const char* name, const std::string& value) : name_(name) {
    const char* before = std::getenv(name);
    had_ = before != nullptr;
    if (had_) before_ = before;
    ::setenv(name, value.c_str(), 1);
  }
  ~Variable() {
    if (had_) {
      ::setenv(name_, before_.c_str(), 1);
    } else {
      ::unsetenv(name_);
    }
  }
  Variable(const Variable&) = delete;
  Variable& operator=(const Variable&) = delete;

 private:
  const char* name_;
  bool had_ = false;
  std::string before_;
};

TEST(WorkFolder, IsThereUntilItGoesUnlessItIsKept) {
  const TemporaryFolder folder;
  const Variable place("TMPDIR", folder.path().string());
  std::filesystem::path removed, kept;
  {
    WorkFolder first("film"), second("film");
    EXPECT_NE(first.path(), second.path());
    EXPECT_EQ(first.path().parent_path(), folder.path());
    EXPECT_THAT(first.path().filename().string(), ::testing::StartsWith("gld-film-"));
    EXPECT_EQ(first.log(), first.path() / "film.log");
    write_file_atomically(first.path() / "a", "1");
    write_file_atomically(second.log(), "2");
    second.keep();
    removed = first.path();
    kept = second.log();
  }
  EXPECT_FALSE(std::filesystem::exists(removed));
  EXPECT_EQ(read_file(kept), "2");
}

TEST(WorkFolder, SaysWhereNoneCanBeMade) {
  const TemporaryFolder folder;
  // A file is no folder, whoever asks.
  write_file_atomically(folder.path() / "file", "");
  const Variable place("TMPDIR", (folder.path() / "file").string());
  EXPECT_THAT(
      error_of([] { const WorkFolder none("film"); }),
      HasSubstr("expected a folder for what film reads and writes, found none could be made; check the "
                "temporary folder ($TMPDIR)."));
}

TEST(FoundProgram, IsTheFirstOfThePathThatCanRun) {
  const TemporaryFolder folder;
  const auto first = folder.path() / "first", second = folder.path() / "second";
  for (const auto& path : {first, second}) std::filesystem::create_directory(path);
  write_file_atomically(first / "tool", "no program");
  write_file_atomically(second / "tool", "#!/bin/sh\n");
  std::filesystem::permissions(first / "tool", std::filesystem::perms::owner_read);
  std::filesystem::permissions(second / "tool", std::filesystem::perms::owner_all);
  const Variable path("PATH", "/nowhere::" + first.string() + ":" + second.string());
  EXPECT_EQ(found_program("tool"), second / "tool");
  EXPECT_TRUE(found_program("other").empty());
  // A folder of the name is no program.
  EXPECT_TRUE(found_program(".").empty());
}

}  // namespace
}  // namespace gld
