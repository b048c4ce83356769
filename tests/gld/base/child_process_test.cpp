#include "gld/base/child_process.h"

#include "gld/base/atomic_file.h"
#include "tests/support/temporary_folder.h"

#include <chrono>
#include <csignal>
#include <fstream>
#include <string>
#include <thread>

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

namespace gld {
namespace {

using std::chrono::milliseconds;

FinishedProcess wait_for(ChildProcess& process) {
  while (!process.poll()) std::this_thread::sleep_for(milliseconds(5));
  return *process.poll();
}

// Reads the number that a shell wrote; waits for it.
pid_t number_in(const std::filesystem::path& file) {
  for (int tries = 0; tries < 2000; ++tries) {
    std::ifstream text(file);
    pid_t number = 0;
    if (text >> number) return number;
    std::this_thread::sleep_for(milliseconds(5));
  }
  ADD_FAILURE() << "expected a number in " << file;
  return 0;
}

// A process that has ended stays in the table until its parent asks for its status.
bool is_running(pid_t process) {
  std::ifstream stat("/proc/" + std::to_string(process) + "/stat");
  std::string number, name, state;
  return static_cast<bool>(stat >> number >> name >> state) && state != "Z";
}

TEST(ChildProcess, SaysHowItEndedAndKeepsWhatItPrinted) {
  const test::TemporaryFolder folder;
  const auto log = folder.path() / "log.txt";
  ChildProcess first({"/bin/sh", "-c", "echo out; echo err >&2; exit 3"}, log, -1);
  const FinishedProcess result = wait_for(first);
  EXPECT_EQ(result.status, 3);
  EXPECT_GT(result.peak_bytes, 0);
  ChildProcess second({"/bin/sh", "-c", "echo again; kill -9 $$"}, log, -1);
  EXPECT_EQ(wait_for(second).status, 128 + SIGKILL);
  EXPECT_EQ(read_file(log), "out\nerr\nagain\n");
  ChildProcess missing({"/no/such/program"}, log, -1);
  EXPECT_EQ(wait_for(missing).status, 127);
}

// Where SIGCHLD is ignored the kernel keeps no status, and what failed would count as done.
TEST(ChildProcess, SaysHowItEndedWhereAChildsEndIsIgnored) {
  const test::TemporaryFolder folder;
  const auto before = std::signal(SIGCHLD, SIG_IGN);
  ChildProcess failed({"/bin/sh", "-c", "exit 3"}, folder.path() / "log.txt", -1);
  EXPECT_EQ(wait_for(failed).status, 3);
  ChildProcess unknown({"/bin/sh", "-c", "exit 0"}, folder.path() / "log.txt", -1);
  std::signal(SIGCHLD, SIG_IGN);
  EXPECT_EQ(wait_for(unknown).status, 125);
  std::signal(SIGCHLD, before);
}

TEST(ChildProcess, IsAskedToStopOnce) {
  const test::TemporaryFolder folder;
  const auto log = folder.path() / "log.txt";
  ChildProcess process({"/bin/sh", "-c",
                        "trap 'echo asked' TERM; echo $$ >" + (folder.path() / "pid").string() +
                            "; sleep 0.3 & wait; sleep 0.3; exit 0"},
                       log, -1);
  number_in(folder.path() / "pid");
  process.stop();
  process.stop();
  EXPECT_EQ(wait_for(process).status, 0);
  EXPECT_EQ(read_file(log), "asked\n");
}

TEST(ChildProcess, StopsWhenItsParentIsKilled) {
  const test::TemporaryFolder folder;
  const auto number = folder.path() / "pid";
  const pid_t parent = ::fork();
  if (parent == 0) {
    // This one would take its time, as a training does at the end of its step, or not stop at all.
    ChildProcess process(
        {"/bin/sh", "-c", "trap '' TERM INT; echo $$ >" + number.string() + "; exec sleep 60"},
        folder.path() / "log", -1);
    wait_for(process);
    ::_exit(0);
  }
  const pid_t child = number_in(number);
  ASSERT_TRUE(is_running(child));
  ::kill(parent, SIGKILL);
  ::waitpid(parent, nullptr, 0);
  for (int tries = 0; tries < 100 && is_running(child); ++tries) std::this_thread::sleep_for(milliseconds(5));
  EXPECT_FALSE(is_running(child));
  ::kill(child, SIGKILL);
}

}  // namespace
}  // namespace gld
