#include "gld/base/child_process.h"

#include "gld/base/error.h"
#include "gld/base/interrupt.h"

#include <cerrno>
#include <csignal>
#include <cstring>
#include <thread>

#include <fcntl.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

namespace gld {
namespace {

constexpr int kCouldNotExecute = 127;  // the shell's convention

// This runs between fork and exec: it does only what is safe in a process that had other threads.
[[noreturn]] void become(char* const* arguments, int log, int keep_open, pid_t parent) {
  ::setpgid(0, 0);
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);                    // which nothing can ignore or put off
  if (::getppid() != parent) ::_exit(kCouldNotExecute);  // it died before the line above
  const int nothing = ::open("/dev/null", O_RDONLY);
  if (nothing >= 0) ::dup2(nothing, STDIN_FILENO);
  ::dup2(log, STDOUT_FILENO);
  ::dup2(log, STDERR_FILENO);
  if (keep_open >= 0) ::fcntl(keep_open, F_SETFD, 0);
  // Processes that train together ignore the first, commands the second, and what is ignored stays so behind exec.
  ::signal(SIGPIPE, SIG_DFL);
  ::signal(SIGXFSZ, SIG_DFL);
  ::execv(arguments[0], arguments);
  ::_exit(kCouldNotExecute);
}

}  // namespace

ChildProcess::ChildProcess(const std::vector<std::string>& command, const std::filesystem::path& log,
                           int keep_open)
    : start_(std::chrono::steady_clock::now()) {
  const int file = ::open(log.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0666);
  if (file < 0) fail({log.string(), "a file that can be written", std::strerror(errno), "check the folder"});
  std::vector<std::string> copies = command;
  std::vector<char*> arguments;
  arguments.reserve(copies.size() + 1);
  for (std::string& argument : copies) arguments.push_back(argument.data());
  arguments.push_back(nullptr);
  const pid_t parent = ::getpid();
  // Who started this program may have ignored it, which is inherited: nobody could then say how a child ended.
  ::signal(SIGCHLD, SIG_DFL);
  process_ = ::fork();
  if (process_ == 0) become(arguments.data(), file, keep_open, parent);
  const int error = errno;
  ::close(file);
  if (process_ < 0) {
    fail({command.front(), "a process of its own", std::strerror(error), "run fewer jobs at a time"});
  }
}

ChildProcess::~ChildProcess() {
  stop();
  while (!poll()) std::this_thread::sleep_for(std::chrono::milliseconds(20));
}

const std::optional<FinishedProcess>& ChildProcess::poll() {
  if (finished_) return finished_;
  int status = 0;
  rusage usage{};
  const pid_t ended = ::wait4(process_, &status, WNOHANG, &usage);
  if (ended == 0 || (ended < 0 && errno == EINTR)) return finished_;
  FinishedProcess result;
  // Where SIGCHLD was ignored meanwhile nobody knows how it ended.
  constexpr int kUnknown = 125;  // no signal: those are above 128
  result.status = ended < 0 ? kUnknown : WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  result.peak_bytes = int64_t{usage.ru_maxrss} * 1024;
  finished_ = result;
  return finished_;
}

void ChildProcess::stop() {
  if (finished_ || stopping_) return;
  stopping_ = true;
  ::kill(process_, SIGTERM);
}

int run_program(const std::vector<std::string>& command, const std::filesystem::path& log,
                const std::string& while_what) {
  ChildProcess process(command, log, -1);
  while (!process.poll()) {
    stop_if_interrupted(while_what);
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  return process.poll()->status;
}

}  // namespace gld
