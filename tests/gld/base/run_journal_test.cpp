#include "gld/base/run_journal.h"

#include "gld/base/atomic_file.h"
#include "tests/support/temporary_folder.h"

#include <csignal>
#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

namespace gld {
namespace {

TEST(RunJournal, NotesWhatItsProcessWritesBelow) {
  test::TemporaryFolder temporary;
  const auto folder = temporary.path() / "run";
  std::filesystem::create_directories(folder / "a" / "b");
  EXPECT_FALSE(RunJournal::find(folder));
  {
    const RunJournal journal(folder);
    write_file_atomically(folder / "a" / "one.txt", "1");
    write_file_atomically(folder / "a" / "one.txt", "1 again");
    write_file_atomically(folder / "a" / "b" / "a \"name\"\n.txt", "2");
    write_file_atomically(temporary.path() / "beside.txt", "3");
    write_file_atomically(folder / "gone.txt", "4");
    std::filesystem::remove(folder / "gone.txt");
  }
  write_file_atomically(folder / "after.txt", "5");
  const auto found = RunJournal::find(folder);
  ASSERT_TRUE(found);
  EXPECT_THAT(found->written, testing::ElementsAre("a/one.txt", "a/b/a \"name\"\n.txt"));
}

// A folder that held something when its journal began was written into by a program without one.
TEST(RunJournal, SaysWhetherItNotesEverything) {
  test::TemporaryFolder fresh, used;
  write_file_atomically(used.path() / "old.txt", "1");
  { const RunJournal first(fresh.path()), second(used.path()); }
  EXPECT_TRUE(RunJournal::find(fresh.path())->complete);
  EXPECT_FALSE(RunJournal::find(used.path())->complete);
  { const RunJournal first(fresh.path()), second(used.path()); }
  EXPECT_TRUE(RunJournal::find(fresh.path())->complete);
  EXPECT_FALSE(RunJournal::find(used.path())->complete);
}

TEST(RunJournal, ADamagedOneReachesNothingOutside) {
  test::TemporaryFolder temporary;
  const auto folder = temporary.path() / "run";
  std::filesystem::create_directory(folder);
  write_file_atomically(temporary.path() / "precious.txt", "x");
  { const RunJournal begun(folder); }
  std::ofstream(folder / ".gld-run", std::ios::app)
      << "\"../precious.txt\"\n\"" << (temporary.path() / "precious.txt").string() << "\"\nnonsense\n";
  RunJournal journal(folder);
  journal.remove_written();
  EXPECT_TRUE(std::filesystem::exists(temporary.path() / "precious.txt"));
}

TEST(RunJournal, KeepsOtherProcessesOutUntilItsOwnEnds) {
  test::TemporaryFolder temporary;
  const pid_t child = ::fork();
  if (child == 0) {
    const RunJournal* never_closed = new RunJournal(temporary.path());
    write_file_atomically(temporary.path() / "started", "x");
    ::pause();
    ::_exit(never_closed == nullptr ? 1 : 0);
  }
  while (!std::filesystem::exists(temporary.path() / "started")) ::usleep(1000);
  EXPECT_THROW(RunJournal::refuse_running(temporary.path()), std::exception);
  ::kill(child, SIGKILL);
  ::waitpid(child, nullptr, 0);
  EXPECT_NO_THROW(RunJournal::refuse_running(temporary.path()));
  // What it wrote is known although it was killed.
  EXPECT_THAT(RunJournal::find(temporary.path())->written, testing::ElementsAre("started"));
}

}  // namespace
}  // namespace gld
