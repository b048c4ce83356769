#include "gld/report/shell_word.h"

#include <algorithm>
#include <cctype>
#include <string_view>

namespace gld {

std::string shell_word(const std::string& text) {
  const bool plain = !text.empty() && std::all_of(text.begin(), text.end(), [](unsigned char letter) {
    return std::isalnum(letter) != 0 ||
           std::string_view("/._-+,:=@").find(static_cast<char>(letter)) != std::string_view::npos;
  });
  if (plain) return text;
  std::string word = "'";
  for (const char letter : text) word += letter == '\'' ? std::string("'\\''") : std::string(1, letter);
  return word + "'";
}

}  // namespace gld
