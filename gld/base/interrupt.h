#pragma once

#include <filesystem>
#include <string>

namespace gld {

// Ctrl-C (SIGINT) and SIGTERM ask a command to stop at its next safe point; a second one stops at once.

// How long a command that was asked to stop may go on.
enum class StopDeadline {
  // It goes on to its next safe point, but no longer than a second: then the process ends wherever it is, with the exit
  // status of an interrupt. Files and folders under their final names are whole, and unfinished ones are removed.
  kOneSecond,
  // It goes on to its next safe point, however long that takes; this is for work that would be lost, as training is
  // before its checkpoint.
  kSafePoint,
};

// Also has a write beyond the largest size of a file fail, which says so, in the place of SIGXFSZ, which ends a
// process.
void install_interrupt_handler(StopDeadline deadline);
bool interrupt_requested();

// Throws Interrupted with what was done so far when a stop was asked for; the deadline is met then.
void stop_if_interrupted(const std::string& done);

constexpr int kInterruptedStatus = 130;  // exit status: the shell's convention for SIGINT

// A file or folder that is not finished, and is removed when the deadline ends the process while this lives.
class Unfinished {
 public:
  explicit Unfinished(std::filesystem::path path);
  ~Unfinished();
  Unfinished(const Unfinished&) = delete;
  Unfinished& operator=(const Unfinished&) = delete;

 private:
  std::filesystem::path path_;
};

}  // namespace gld
