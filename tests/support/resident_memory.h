#pragma once

#include <cstdint>
#include <fstream>

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

namespace gld::test {

// Resident memory of this process now, in bytes: the second number of proc(5)'s statm counts pages.
inline int64_t resident_bytes() {
  std::ifstream stream("/proc/self/statm");
  int64_t mapped = 0, resident = 0;
  stream >> mapped >> resident;
  return resident * sysconf(_SC_PAGESIZE);
}

// The most resident memory that this process has had so far, in bytes.
inline int64_t highest_resident_bytes() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return int64_t{1024} * usage.ru_maxrss;
}

// Runs action and expects it to take less memory than this beyond the highest so far.
template <class Action>
void expect_little_memory(const Action& action) {
  constexpr int64_t kLittle = int64_t{300} << 20;
  const int64_t before = highest_resident_bytes();
  action();
  EXPECT_LT(highest_resident_bytes() - before, kLittle);
}

}  // namespace gld::test
