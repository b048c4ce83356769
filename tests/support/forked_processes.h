#pragma once

#include "gld/distributed/process_placement.h"

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>

#include <sys/types.h>

namespace gld::test {

// Real processes for tests of several that work together. Forked before this one has started a thread: what computes
// with LibTorch in such a test does so in a child.

int64_t free_port();

struct Child {
  pid_t process = 0;
  std::filesystem::path said;  // its standard error
};

// Starts a child of one thread that does the work and ends; its status is 1 with "error: ..." said where that throws.
Child start(const std::filesystem::path& folder, const std::string& name, const std::function<void()>& work);

// Returns the exit status; it is -signal where one ended it, 1000 where it goes on for longer than that.
int status_of(const Child& child, double most_seconds = 120);

// The processes are on this machine, each waiting 30 s for the others.
ProcessPlacement placement(int64_t rank, int64_t count, int64_t port);
// Returns the same as options; they are those of one process alone for a count of 1.
ProcessesOptions processes(int64_t rank, int64_t count, int64_t port);

// Does the work once, in so many processes that work together, each of which must succeed.
void in_processes(int64_t count, const std::filesystem::path& folder,
                  const std::function<void(const ProcessesOptions&)>& work);

}  // namespace gld::test
