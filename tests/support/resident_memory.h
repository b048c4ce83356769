#pragma once

#include <cstdint>
#include <fstream>

#include <unistd.h>

namespace gld::test {

// Resident memory of this process now, in bytes: the second number of proc(5)'s statm counts pages.
inline int64_t resident_bytes() {
  std::ifstream stream("/proc/self/statm");
  int64_t mapped = 0, resident = 0;
  stream >> mapped >> resident;
  return resident * sysconf(_SC_PAGESIZE);
}

}  // namespace gld::test
