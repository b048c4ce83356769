#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <sys/types.h>

namespace gld {

struct FinishedProcess {
  int status = 0;  // exit status; 128 + the signal where one ended it
  double seconds = 0;
  int64_t peak_bytes = 0;  // largest resident memory
};

// A command that runs beside this one, its output in a file. It has a process group of its own, so that Ctrl-C reaches
// it through stop() alone and once: a second signal would end a training before its checkpoint. When this process is
// killed, however, the system kills it too: nobody would wait for its safe point, or take what it makes.
class ChildProcess {
 public:
  // Appends standard output and standard error to log. keep_open is a file descriptor that the child holds as long as
  // it runs (a lock), or -1. Throws Error where the process cannot be started.
  ChildProcess(const std::vector<std::string>& command, const std::filesystem::path& log, int keep_open);
  // Stops it and waits for its end.
  ~ChildProcess();
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  pid_t id() const { return process_; }
  // Empty as long as it runs.
  const std::optional<FinishedProcess>& poll();
  // Asks it to stop at its next safe point; it asks once, however often this is called.
  void stop();

 private:
  pid_t process_ = -1;
  bool stopping_ = false;
  std::chrono::steady_clock::time_point start_;
  std::optional<FinishedProcess> finished_;
};

// Runs a command to its end, its output appended to log; returns its exit status. Ctrl-C stops it and throws
// Interrupted, which says `while_what` ("while COLMAP registered photographs"). Throws Error where it cannot be
// started.
int run_program(const std::vector<std::string>& command, const std::filesystem::path& log,
                const std::string& while_what);

}  // namespace gld
