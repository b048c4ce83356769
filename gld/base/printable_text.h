#pragma once

#include <cstddef>
#include <string>

namespace gld {

// Returns text of unknown origin (a file's name, a value from a file) as it may stand in a message: always UTF-8, on
// one line, and without anything that a terminal obeys. Control characters, bytes that are no UTF-8 and the marks that
// turn the direction of writing become "\n", "\x1b", "\u202e"; everything else stays as it is.
std::string printable_text(const std::string& text);

// Returns the first `most` bytes of it, and "..." where there is more; it never returns half a character.
std::string printable_text(const std::string& text, size_t most);

}  // namespace gld
