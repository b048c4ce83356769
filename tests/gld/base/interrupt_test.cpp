#include "gld/base/interrupt.h"

#include "gld/base/atomic_file.h"
#include "gld/base/atomic_folder.h"
#include "gld/base/error.h"
#include "gld/base/run_journal.h"
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

void work_of_seconds(int seconds) {
  for (const auto end = Clock::now() + std::chrono::seconds(seconds); Clock::now() < end;) {
  }
}

void work_without_safe_point(StopDeadline deadline) {
  install_interrupt_handler(deadline);
  work_of_seconds(4);
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

// What a parent that dies with several threads sends its child: one request, several times.
TEST(Interrupt, SignalsAtOnceAreOneRequestAndALaterOneStops) {
  const auto twice = [](int milliseconds) {
    return [milliseconds] {
      install_interrupt_handler(StopDeadline::kSafePoint);
      while (!interrupt_requested()) {
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(milliseconds));
      std::raise(SIGTERM);
    };
  };
  const auto at_once = stopped(twice(0), SIGTERM);
  ASSERT_TRUE(WIFEXITED(at_once.status));
  EXPECT_EQ(WEXITSTATUS(at_once.status), 7);  // it came to its end
  const auto later = stopped(twice(300), SIGTERM);
  ASSERT_TRUE(WIFSIGNALED(later.status));
  EXPECT_EQ(WTERMSIG(later.status), SIGTERM);
}

TEST(Interrupt, LeavesNoUnfinishedFolder) {
  test::TemporaryFolder folder;
  const auto ended = stopped(
      [&] {
        const AtomicFolder scene(folder.path() / "scene");
        std::filesystem::create_directory(scene.temporary() / "images");
        std::ofstream(scene.temporary() / "images" / "a.png") << "half";
        work_without_safe_point(StopDeadline::kOneSecond);
      },
      SIGINT);
  EXPECT_EQ(WEXITSTATUS(ended.status), kInterruptedStatus);
  EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
}

TEST(Interrupt, PutsBackTheRunThatWasToBeReplaced) {
  test::TemporaryFolder folder;
  {
    const RunJournal journal(folder.path());
    write_file_atomically(folder.path() / "report.json", "earlier");
  }
  const auto ended = stopped(
      [&] {
        RunJournal journal(folder.path());
        journal.put_earlier_aside();
        write_file_atomically(folder.path() / kRunConfiguration, "new");
        work_without_safe_point(StopDeadline::kOneSecond);
      },
      SIGINT);
  EXPECT_EQ(WEXITSTATUS(ended.status), kInterruptedStatus);
  EXPECT_EQ(read_file(folder.path() / "report.json"), "earlier");
  EXPECT_FALSE(std::filesystem::exists(folder.path() / kRunConfiguration));
}

TEST(Interrupt, ASafePointInTimeMeetsTheDeadlineOnce) {
  const auto ended = stopped(
      [] {
        install_interrupt_handler(StopDeadline::kOneSecond);
        while (!interrupt_requested()) {
        }
        for (int i = 0; i < 3; ++i) EXPECT_THROW(stop_if_interrupted("half"), Interrupted);
        // Longer than the deadline: what is done after a safe point, writing a report for instance, is not cut.
        std::this_thread::sleep_for(std::chrono::milliseconds(1500));
        install_interrupt_handler(StopDeadline::kOneSecond);
        std::raise(SIGINT);
        work_of_seconds(4);
      },
      SIGINT);
  EXPECT_EQ(WEXITSTATUS(ended.status), kInterruptedStatus);
  EXPECT_GT(ended.seconds, 2.4);
  EXPECT_LT(ended.seconds, 4);
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
