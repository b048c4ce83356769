#pragma once

#include "gld/base/mapped_file.h"

#include <cstdint>
#include <string>

namespace gld::test {

// Returns the bytes of text, which must outlive them.
inline ByteView view_of_text(const std::string& text) {
  return {reinterpret_cast<const uint8_t*>(text.data()), text.size()};
}

}  // namespace gld::test
