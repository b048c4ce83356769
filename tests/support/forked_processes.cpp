#include "tests/support/forked_processes.h"

#include "gld/base/atomic_file.h"
#include "gld/tensors/torch_version.h"

#include <chrono>
#include <csignal>
#include <cstdlib>
#include <exception>
#include <thread>
#include <vector>

#include <arpa/inet.h>
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

namespace gld::test {

int64_t free_port() {
  const int number = ::socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address = {};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof(address);
  EXPECT_EQ(::bind(number, reinterpret_cast<sockaddr*>(&address), size), 0);
  EXPECT_EQ(::getsockname(number, reinterpret_cast<sockaddr*>(&address), &size), 0);
  ::close(number);
  return ntohs(address.sin_port);
}

Child start(const std::filesystem::path& folder, const std::string& name, const std::function<void()>& work) {
  Child child{0, folder / (name + ".txt")};
  child.process = ::fork();
  if (child.process != 0) return child;
  const int file = ::open(child.said.c_str(), O_CREAT | O_TRUNC | O_WRONLY, 0600);
  ::dup2(file, STDERR_FILENO);
  try {
    set_thread_count(1);
    work();
  } catch (const std::exception& error) {
    const std::string line = std::string("error: ") + error.what() + "\n";
    if (::write(STDERR_FILENO, line.data(), line.size()) < 0) std::_Exit(3);
    std::_Exit(1);
  }
  std::_Exit(0);
}

int status_of(const Child& child, double most_seconds) {
  const auto begun = std::chrono::steady_clock::now();
  int status = 0;
  while (::waitpid(child.process, &status, WNOHANG) == 0) {
    if (std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count() > most_seconds) {
      ::kill(child.process, SIGKILL);
      ::waitpid(child.process, &status, 0);
      return 1000;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
}

ProcessPlacement placement(int64_t rank, int64_t count, int64_t port) {
  return process_placement(processes(rank, count, port), [](const std::string&) { return std::nullopt; });
}

ProcessesOptions processes(int64_t rank, int64_t count, int64_t port) {
  ProcessesOptions options;
  options.count = count;
  if (count == 1) return options;
  options.rank = rank;
  options.master_address = "127.0.0.1";
  options.master_port = port;
  options.join_seconds = 30;
  return options;
}

void in_processes(int64_t count, const std::filesystem::path& folder,
                  const std::function<void(const ProcessesOptions&)>& work) {
  const int64_t port = free_port();
  std::vector<Child> children;
  for (int64_t rank = 0; rank < count; ++rank) {
    children.push_back(
        start(folder, "rank" + std::to_string(rank), [&] { work(processes(rank, count, port)); }));
  }
  for (const Child& child : children) EXPECT_EQ(status_of(child), 0) << read_file(child.said);
}

}  // namespace gld::test
