#include "gld/base/run_journal.h"

#include "gld/base/atomic_file.h"
#include "tests/support/error_of.h"
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

// File names are bytes; one that is no UTF-8 is still found again.
TEST(RunJournal, NotesNamesThatAreNoText) {
  test::TemporaryFolder temporary;
  const std::string name = "caf\xe9.png";
  {
    const RunJournal journal(temporary.path());
    write_file_atomically(temporary.path() / name, "1");
  }
  EXPECT_THAT(RunJournal::find(temporary.path())->written, testing::ElementsAre(name));
}

// A killed run's header names a process whose number comes again.
TEST(RunJournal, OfAKilledRunTakesNoMoreNotes) {
  test::TemporaryFolder temporary;
  { const RunJournal ended(temporary.path()); }
  const auto header = read_file(temporary.path() / ".gld-run");
  const auto at = header.find("\"process\":0");
  ASSERT_NE(at, std::string::npos);
  const std::string own = "\"process\":" + std::to_string(::getpid());
  std::ofstream(temporary.path() / ".gld-run", std::ios::binary)
      << header.substr(0, at) << own << header.substr(at + own.size());
  write_file_atomically(temporary.path() / "by_hand.txt", "x");
  EXPECT_TRUE(RunJournal::find(temporary.path())->written.empty());
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
  journal.put_earlier_aside();
  EXPECT_TRUE(std::filesystem::exists(temporary.path() / "precious.txt"));
}

// A link that somebody has put in the place of a folder leads to files that are none of the run's.
TEST(RunJournal, FollowsNoSymbolicLink) {
  test::TemporaryFolder temporary;
  const auto folder = temporary.path() / "run", album = temporary.path() / "album";
  for (const auto& made : {folder, folder / "images", album}) std::filesystem::create_directory(made);
  std::filesystem::remove(folder / "images");
  {
    const RunJournal journal(folder);
    std::filesystem::create_directory(folder / "images");
    write_file_atomically(folder / "images" / "0.png", "the run's");
  }
  std::filesystem::remove_all(folder / "images");
  write_file_atomically(album / "0.png", "mine");
  std::filesystem::create_directory_symlink(album, folder / "images");
  {
    RunJournal journal(folder);
    journal.put_earlier_aside();
    write_file_atomically(folder / "result", "x");
  }
  EXPECT_EQ(read_file(album / "0.png"), "mine");
}

TEST(RunJournal, PutsTheEarlierRunBackUnlessThereIsAResult) {
  test::TemporaryFolder temporary;
  const auto& folder = temporary.path();
  const auto run = [&](const std::vector<std::string>& written) {
    RunJournal journal(folder);
    journal.put_earlier_aside();
    for (const auto& name : written) {
      std::filesystem::create_directories((folder / name).parent_path());
      write_file_atomically(folder / name, written.front());
    }
  };
  run({kRunConfiguration, "images/0.png", "report.json"});
  write_file_atomically(folder / "notes.txt", "mine");
  run({});
  run({kRunConfiguration, kRunProgress});
  EXPECT_THAT(RunJournal::find(folder)->written,
              testing::ElementsAre(kRunConfiguration, "images/0.png", "report.json"));
  EXPECT_FALSE(RunJournal::has_earlier_aside(folder));
  run({"report.json"});
  EXPECT_THAT(RunJournal::find(folder)->written, testing::ElementsAre("report.json"));
  EXPECT_FALSE(std::filesystem::exists(folder / "images"));
  EXPECT_EQ(read_file(folder / "notes.txt"), "mine");
  // A name that was the earlier run's and is somebody else's now does not go with the next one.
  std::filesystem::create_directory(folder / "images");
  write_file_atomically(folder / "images/0.png", "mine");
  run({"table.csv"});
  EXPECT_EQ(read_file(folder / "images/0.png"), "mine");
  std::vector<std::string> there;
  for (const auto& item : std::filesystem::directory_iterator(folder)) {
    there.push_back(item.path().filename().string());
  }
  EXPECT_THAT(there, testing::UnorderedElementsAre(".gld-run", "images", "notes.txt", "table.csv"));
}

// Its lines do not depend on how often the clock had a file written again.
TEST(RunJournal, NotesAFileOnce) {
  test::TemporaryFolder temporary;
  const auto& folder = temporary.path();
  {
    const RunJournal journal(folder);
    for (const char* name : {kRunProgress, "a.txt", kRunProgress, "b.txt", kRunProgress}) {
      write_file_atomically(folder / name, "x");
    }
  }
  const std::string journal = read_file(folder / ".gld-run");
  EXPECT_EQ(journal.substr(journal.find('\n')), "\n\"progress.json\"\n\"a.txt\"\n\"b.txt\"\n");
  // One that somebody else put there is noted when a run writes it.
  write_file_atomically(folder / "mine.txt", "mine");
  {
    const RunJournal again(folder);
    write_file_atomically(folder / "mine.txt", "the run's");
  }
  EXPECT_THAT(RunJournal::find(folder)->written,
              testing::ElementsAre(kRunProgress, "a.txt", "b.txt", "mine.txt"));
}

// Killed before its first result, a run leaves the earlier one aside, where the next that begins anew finds it whole.
TEST(RunJournal, KeepsTheEarlierRunThroughAKill) {
  test::TemporaryFolder temporary;
  const auto& folder = temporary.path();
  {
    const RunJournal journal(folder);
    for (const char* name : {kRunConfiguration, "report.json"}) write_file_atomically(folder / name, "first");
  }
  const pid_t child = ::fork();
  if (child == 0) {
    auto* never_closed = new RunJournal(folder);
    never_closed->put_earlier_aside();
    write_file_atomically(folder / kRunConfiguration, "second");
    ::_exit(0);
  }
  ::waitpid(child, nullptr, 0);
  EXPECT_TRUE(RunJournal::has_earlier_aside(folder));
  EXPECT_EQ(read_file(folder / kRunConfiguration), "second");
  {
    RunJournal third(folder);
    third.put_earlier_aside();
    write_file_atomically(folder / kRunConfiguration, "third");
  }
  EXPECT_EQ(read_file(folder / kRunConfiguration), "first");
  EXPECT_EQ(read_file(folder / "report.json"), "first");
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
  for (int waited = 0; !std::filesystem::exists(temporary.path() / "started"); ++waited) {
    ASSERT_LT(waited, 20'000) << "the child never started";
    ::usleep(1000);
  }
  EXPECT_THAT(
      test::error_of([&] { RunJournal::refuse_running(temporary.path()); }),
      testing::AllOf(testing::StartsWith(temporary.path().string() +
                                         ": expected a run folder that no other process writes, found one "
                                         "that another process is writing (process " +
                                         std::to_string(child) + " on "),
                     testing::EndsWith("; wait for it or choose another --out.")));
  ::kill(child, SIGKILL);
  ::waitpid(child, nullptr, 0);
  EXPECT_NO_THROW(RunJournal::refuse_running(temporary.path()));
  // What it wrote is known although it was killed.
  EXPECT_THAT(RunJournal::find(temporary.path())->written, testing::ElementsAre("started"));
}

}  // namespace
}  // namespace gld
