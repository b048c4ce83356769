#pragma once

#include <string>

namespace gld {

// Returns text as a shell takes it for one word: as it is, or in quotes where it needs them.
std::string shell_word(const std::string& text);

}  // namespace gld
