#include "gld/base/interrupt.h"

#include "gld/base/error.h"
#include "gld/base/interrupted_end.h"

#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstdint>
#include <ctime>
#include <exception>
#include <functional>
#include <map>
#include <mutex>
#include <system_error>
#include <thread>
#include <utility>

#include <semaphore.h>
#include <unistd.h>

namespace gld {
namespace {

// A signal handler can reach nothing but static objects.
volatile std::sig_atomic_t requested = 0;
volatile std::sig_atomic_t has_deadline = 0;
std::atomic<int64_t> requested_at{0};  // by now()
std::atomic<bool> waits{false};        // whether the watch waits for the safe point

struct Watch {
  sem_t asked{};  // a stop within the deadline was asked for
  sem_t met{};    // and the safe point was reached
  std::mutex mutex;
  std::map<const void*, std::function<void()>> unfinished;  // by what registered it

  Watch() {
    ::sem_init(&asked, 0, 0);
    ::sem_init(&met, 0, 0);
  }
};

// The watch is never destroyed: its thread waits until the process ends.
Watch& watch() {
  static Watch* const only = new Watch;
  return *only;
}

[[noreturn]] void end_process_saying(const std::string& text) {
  const std::lock_guard<std::mutex> lock(watch().mutex);
  for (const auto& [owner, undo] : watch().unfinished) {
    try {
      undo();
    } catch (const std::exception&) {
      // The others are undone all the same.
    }
  }
  if (::write(STDERR_FILENO, text.data(), text.size()) < 0) ::_exit(kInterruptedStatus);
  ::_exit(kInterruptedStatus);
}

// A thread, because the end removes files, which a signal handler may not: it may neither lock nor take memory.
void end_at_the_deadline() {
  while (true) {
    while (::sem_wait(&watch().asked) != 0) {
    }
    timespec deadline{};
    // The deadline is not by the time of day, which may be set back meanwhile.
    ::clock_gettime(CLOCK_MONOTONIC, &deadline);
    deadline.tv_sec += 1;
    int met = 0;
    do {
      met = ::sem_clockwait(&watch().met, CLOCK_MONOTONIC, &deadline);
    } while (met != 0 && errno == EINTR);
    if (met == 0) continue;
    end_process_saying("interrupted: stopped in the middle of its work; files that are there are whole\n");
  }
}

// Returns milliseconds of a clock that only moves on; it may be called in a signal handler.
int64_t now() {
  timespec time{};
  ::clock_gettime(CLOCK_MONOTONIC, &time);
  return int64_t{time.tv_sec} * 1000 + time.tv_nsec / 1'000'000;
}

// A parent of several threads that is killed sends its PR_SET_PDEATHSIG once for each thread that the child was handed
// on to while it died: these are one request and not a second one. No hand is so fast.
constexpr int64_t kOneRequest = 100;  // ms

void request(int signal) {
  if (requested == 0) {
    requested_at = now();
  } else if (now() - requested_at > kOneRequest) {
    std::signal(signal, SIG_DFL);  // the second one stops at once
    ::raise(signal);
    return;
  }
  requested = 1;
  if (has_deadline == 0 || waits.exchange(true)) return;
  ::sem_post(&watch().asked);
}

}  // namespace

void install_interrupt_handler(StopDeadline deadline) {
  static pid_t watched = 0;  // by a thread, which a child of the process does not have
  if (watched != ::getpid()) std::thread(end_at_the_deadline).detach();
  watched = ::getpid();
  requested = 0;
  has_deadline = deadline == StopDeadline::kOneSecond ? 1 : 0;
  std::signal(SIGINT, request);
  std::signal(SIGTERM, request);
  // A file that may not grow any more is a write that fails, which says so, and not the end.
  std::signal(SIGXFSZ, SIG_IGN);
}

bool interrupt_requested() { return requested != 0; }

void stop_if_interrupted(const std::string& done) {
  if (!interrupt_requested()) return;
  if (waits.exchange(false)) ::sem_post(&watch().met);
  throw Interrupted(done);
}

void end_interrupted_process(const std::string& done) { end_process_saying("interrupted: " + done + "\n"); }

Unfinished::Unfinished(std::filesystem::path path) : path_(std::move(path)) {
  const std::lock_guard<std::mutex> lock(watch().mutex);
  watch().unfinished[this] = [path = path_] {
    std::error_code ignored;
    std::filesystem::remove_all(path, ignored);
  };
}

Unfinished::~Unfinished() {
  const std::lock_guard<std::mutex> lock(watch().mutex);
  watch().unfinished.erase(this);
}

UndoneAtEnd::UndoneAtEnd(std::function<void()> undo) {
  const std::lock_guard<std::mutex> lock(watch().mutex);
  watch().unfinished[this] = std::move(undo);
}

UndoneAtEnd::~UndoneAtEnd() {
  const std::lock_guard<std::mutex> lock(watch().mutex);
  watch().unfinished.erase(this);
}

}  // namespace gld
