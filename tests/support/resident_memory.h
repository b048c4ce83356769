#pragma once

#include "gld/machine/stage_record.h"

#include <cstdint>
#include <fstream>

#include <gtest/gtest.h>
#include <unistd.h>

namespace gld::test {

// Returns the resident memory of this process now, in bytes: the second number of proc(5)'s statm counts pages.
inline int64_t resident_bytes() {
  std::ifstream stream("/proc/self/statm");
  int64_t mapped = 0, resident = 0;
  stream >> mapped >> resident;
  return resident * sysconf(_SC_PAGESIZE);
}

// Runs action and expects it to take less memory than this beyond the highest so far.
template <class Action>
void expect_little_memory(const Action& action) {
  constexpr int64_t kLittle = int64_t{300} << 20;
  const int64_t before = peak_resident_bytes();
  ASSERT_GT(before, 0) << "the system does not tell it";
  action();
  EXPECT_LT(peak_resident_bytes() - before, kLittle);
}

}  // namespace gld::test
