#pragma once

#include "gld/report/table.h"

#include <cstdint>
#include <string>

namespace gld {

// Returns the cell of a number; it is empty where 0 says that nothing was measured.
inline TableCell if_measured(double value) { return value > 0 ? TableCell(value) : TableCell(std::string()); }
inline TableCell if_measured(int64_t value) {
  return value > 0 ? TableCell(value) : TableCell(std::string());
}

}  // namespace gld
