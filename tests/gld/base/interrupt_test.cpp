#include "gld/base/interrupt.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "tests/support/temporary_folder.h"

#include <chrono>
#include <csignal>
#include <fstream>
#include <functional>
#include <thread>

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

namespace gld {
namespace {

using Clock = std::chrono::steady_clock;

TEST(Interrupt, StopsAtTheNextSafePoint) {
  install_interrupt_handler(StopDeadline::kOneSecond);
  EXPECT_NO_THROW(stop_if_interrupted("nothing"));
  std::raise(SIGINT);
  EXPECT_TRUE(interrupt_requested());
  try {
    stop_if_interrupted("2 of 3 views are finished");
    FAIL() << "it went on";
  } catch (const Interrupted& interrupted) {
    EXPECT_STREQ(interrupted.what(), "2 of 3 views are finished");
  }
  install_interrupt_handler(StopDeadline::kOneSecond);
}

struct Ended {
  int status = -1;
  double seconds = 0;
};

// Runs work in a process of its own, sends it the signal after a fifth of a second, and waits for its end.
Ended stopped(const std::function<void()>& work, int signal) {
  const pid_t child = ::fork();
  if (child == 0) {
    work();
    ::_exit(7);
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(200));
  const auto begun = Clock::now();
  ::kill(child, signal);
  Ended ended;
  ::waitpid(child, &ended.status, 0);
  ended.seconds = std::chrono::duration<double>(Clock::now() - begun).count();
  return ended;
}

void work_without_safe_point(StopDeadline deadline) {
  install_interrupt_handler(deadline);
  for (const auto end = Clock::now() + std::chrono::seconds(4); Clock::now() < end;) {
  }
}

TEST(Interrupt, EndsWorkThatHasNoSafePoint) {
  for (const int signal : {SIGINT, SIGTERM}) {
    const auto ended = stopped([] { work_without_safe_point(StopDeadline::kOneSecond); }, signal);
    ASSERT_TRUE(WIFEXITED(ended.status));
    EXPECT_EQ(WEXITSTATUS(ended.status), kInterruptedStatus);
    EXPECT_LT(ended.seconds, 2);
  }
}

TEST(Interrupt, WaitsForTheSafePointWhereWorkWouldBeLost) {
  const auto ended = stopped([] { work_without_safe_point(StopDeadline::kSafePoint); }, SIGTERM);
  ASSERT_TRUE(WIFEXITED(ended.status));
  EXPECT_EQ(WEXITSTATUS(ended.status), 7);  // it came to its end
}

TEST(Interrupt, LeavesNoUnfinishedFile) {
  test::TemporaryFolder folder;
  const auto ended = stopped(
      [&] {
        AtomicFile file(folder.path() / "large.bin");
        std::ofstream(file.temporary()) << "half";
        work_without_safe_point(StopDeadline::kOneSecond);
      },
      SIGINT);
  EXPECT_EQ(WEXITSTATUS(ended.status), kInterruptedStatus);
  EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
}

}  // namespace
}  // namespace gld
