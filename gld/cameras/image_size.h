#pragma once

#include <cstdint>

namespace gld {

struct ImageSize {
  int64_t width = 0;   // pixels
  int64_t height = 0;  // pixels
};

}  // namespace gld
