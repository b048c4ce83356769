#include "gld/base/atomic_folder.h"

#include "gld/base/atomic_file.h"
#include "gld/base/run_journal.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

namespace gld {
namespace {

using test::error_of;
using test::TemporaryFolder;

std::vector<std::string> names_in(const std::filesystem::path& folder) {
  std::vector<std::string> names;
  for (const auto& item : std::filesystem::directory_iterator(folder))
    names.push_back(item.path().filename().string());
  std::sort(names.begin(), names.end());
  return names;
}

// Returns the number of a process that runs no more.
long ended_process() {
  const pid_t child = fork();
  if (child == 0) _exit(0);
  waitpid(child, nullptr, 0);
  return child;
}

TEST(AtomicFolder, AppearsWholeOrNotAtAll) {
  const TemporaryFolder folder;
  const auto target = folder.path() / "scene";
  {
    const AtomicFolder unfinished(target);
    EXPECT_EQ(unfinished.temporary().filename(), "scene");
    write_file_atomically(unfinished.temporary() / "a", "1");
    EXPECT_FALSE(std::filesystem::exists(target));
  }
  EXPECT_TRUE(names_in(folder.path()).empty());
  for (const bool empty_before : {false, true}) {
    if (empty_before) {
      std::filesystem::remove_all(target);
      std::filesystem::create_directory(target);
    }
    AtomicFolder whole(target / "");
    write_file_atomically(whole.temporary() / "1", "1");
    whole.commit();
    EXPECT_EQ(names_in(target), std::vector<std::string>{"1"});
  }
  EXPECT_EQ(names_in(folder.path()), std::vector<std::string>{"scene"});
  // What somebody has put there stays, also what came while the folder was being filled.
  EXPECT_EQ(error_of([&] { AtomicFolder{target}; }),
            target.string() +
                ": expected a new or empty folder, found one with other files; move them or choose "
                "another output.");
  {
    const auto other = folder.path() / "other";
    AtomicFolder late(other);
    write_file_atomically(late.temporary() / "1", "1");
    std::filesystem::create_directory(other);
    write_file_atomically(other / "precious", "x");
    EXPECT_FALSE(error_of([&] { late.commit(); }).empty());
    EXPECT_EQ(names_in(other), std::vector<std::string>{"precious"});
  }
  EXPECT_EQ(names_in(folder.path()), (std::vector<std::string>{"other", "scene"}));
  EXPECT_EQ(error_of([&] { AtomicFolder(folder.path() / "none" / "scene"); }),
            (folder.path() / "none" / "scene").string() +
                ": expected an existing folder to write into, found no folder " +
                (folder.path() / "none").string() + "; create it or choose another output.");
}

TEST(AtomicFolder, ACopyAppearsWholeOrNotAtAll) {
  const TemporaryFolder folder;
  write_file_atomically(folder.path() / "from", "new");
  write_file_atomically(folder.path() / "to", "old");
  copy_file_atomically(folder.path() / "from", folder.path() / "to");
  EXPECT_EQ(read_file(folder.path() / "to"), "new");
  EXPECT_FALSE(error_of([&] { copy_file_atomically(folder.path() / "none", folder.path() / "to"); }).empty());
  EXPECT_EQ(read_file(folder.path() / "to"), "new");
  EXPECT_EQ(names_in(folder.path()), (std::vector<std::string>{"from", "to"}));
}

TEST(AtomicFolder, WhatKilledProcessesLeftIsRemoved) {
  const TemporaryFolder folder;
  const std::string ended = std::to_string(ended_process()), own = std::to_string(getpid());
  const std::string alive = std::to_string(getppid());
  const auto inner = folder.path() / "checkpoints";
  std::filesystem::create_directories(inner);
  write_file_atomically(inner / (".step_1.partial-" + ended + "-0.safetensors"), "x");
  write_file_atomically(folder.path() / (".config.partial-" + own + "-7.yaml"), "x");
  write_file_atomically(folder.path() / (".config.partial-" + alive + "-7.yaml"), "x");
  write_file_atomically(folder.path() / "notes.partial-1-2", "not hidden");
  write_file_atomically(folder.path() / ".partial-", "no number");
  std::filesystem::create_directories(folder.path() / (".scene.partial-" + ended + "-3") / "scene");
  // A file that a finished process wrote last must go, what a link leads to must not.
  const TemporaryFolder elsewhere;
  write_file_atomically(elsewhere.path() / (".a.partial-" + ended + "-0"), "x");
  std::filesystem::create_directory_symlink(elsewhere.path(), folder.path() / "linked");
  const auto other_run = folder.path() / "other_run";
  std::filesystem::create_directory(other_run);
  { const RunJournal journal(other_run); }
  write_file_atomically(other_run / (".step_1.partial-" + ended + "-0.safetensors"), "x");
  remove_abandoned_files(folder.path());
  EXPECT_EQ(names_in(other_run).size(), 2U);
  EXPECT_EQ(names_in(folder.path()),
            (std::vector<std::string>{".config.partial-" + alive + "-7.yaml", ".partial-", "checkpoints",
                                      "linked", "notes.partial-1-2", "other_run"}));
  EXPECT_TRUE(names_in(inner).empty());
  EXPECT_EQ(names_in(elsewhere.path()).size(), 1U);
}

TEST(AtomicFolder, TheNameSaysWhichProcess) {
  EXPECT_EQ(process_of_temporary_name(".model.partial-12-0.safetensors"), 12);
  EXPECT_EQ(process_of_temporary_name(".scene.partial-12-3"), 12);
  for (const char* name :
       {"model.partial-12-0.safetensors", ".partial-12", ".a.partial-x-1", ".a.partial-0-1",
        ".a.partial--5-1", ".a.partial-5-", ".a.partial-5-1x", "", ".a.partial-99999999999999999999-1"}) {
    EXPECT_EQ(process_of_temporary_name(name), 0) << name;
  }
}

}  // namespace
}  // namespace gld
