#include "gld/tensors/out_of_memory.h"

#include <string>

namespace gld {

bool is_out_of_memory(const c10::Error& error) {
  const std::string words = error.what_without_backtrace();
  return words.find("out of memory") != std::string::npos ||
         words.find("can't allocate memory") != std::string::npos;
}

}  // namespace gld
