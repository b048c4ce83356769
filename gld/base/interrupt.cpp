#include "gld/base/interrupt.h"

#include "gld/base/error.h"
#include "gld/base/interrupted_end.h"

#include <array>
#include <atomic>
#include <csignal>
#include <cstring>

#include <unistd.h>

namespace gld {
namespace {

// A signal handler can reach nothing but static objects.
volatile std::sig_atomic_t requested = 0;
volatile std::sig_atomic_t has_deadline = 0;

constexpr size_t kLongestName = 1000;
struct UnfinishedFile {
  enum State { kFree, kBeingNamed, kNamed };
  std::atomic<int> state{kFree};
  std::array<char, kLongestName + 1> name{};
};
std::array<UnfinishedFile, 64> unfinished_files;

// Only what is safe in a signal handler: no lock, no memory.
[[noreturn]] void end_process_saying(const char* text, size_t length) {
  for (auto& file : unfinished_files) {
    if (file.state.load() == UnfinishedFile::kNamed) ::unlink(file.name.data());
  }
  if (::write(STDERR_FILENO, text, length) < 0) ::_exit(kInterruptedStatus);
  ::_exit(kInterruptedStatus);
}

void end_process(int) {
  constexpr char kText[] = "interrupted: stopped in the middle of its work; files that are there are whole\n";
  end_process_saying(kText, sizeof(kText) - 1);
}

void request(int signal) {
  requested = 1;
  std::signal(signal, SIG_DFL);  // the second one stops at once
  if (has_deadline != 0) ::alarm(1);
}

}  // namespace

void install_interrupt_handler(StopDeadline deadline) {
  requested = 0;
  has_deadline = deadline == StopDeadline::kOneSecond ? 1 : 0;
  std::signal(SIGALRM, end_process);
  std::signal(SIGINT, request);
  std::signal(SIGTERM, request);
}

bool interrupt_requested() { return requested != 0; }

void stop_if_interrupted(const std::string& done) {
  if (!interrupt_requested()) return;
  ::alarm(0);
  throw Interrupted(done);
}

void end_interrupted_process(const std::string& done) {
  const std::string text = "interrupted: " + done + "\n";
  end_process_saying(text.data(), text.size());
}

void remove_if_unfinished(const std::string& file) {
  if (file.size() > kLongestName) return;
  for (auto& slot : unfinished_files) {
    int free = UnfinishedFile::kFree;
    if (!slot.state.compare_exchange_strong(free, UnfinishedFile::kBeingNamed)) continue;
    std::memcpy(slot.name.data(), file.c_str(), file.size() + 1);
    slot.state.store(UnfinishedFile::kNamed);
    return;
  }
}

void finished(const std::string& file) {
  for (auto& slot : unfinished_files) {
    if (slot.state.load() == UnfinishedFile::kNamed && file == slot.name.data()) {
      slot.state.store(UnfinishedFile::kFree);
    }
  }
}

}  // namespace gld
