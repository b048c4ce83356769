#include "gld/base/error.h"

#include "gld/base/printable_text.h"

#include <algorithm>

namespace gld {
namespace {

// A name or value of unknown origin may be as long as a file: its beginning and its end say which it is. Paths are
// longer than other words.
std::string with_short_words(const std::string& text) {
  constexpr size_t kLongest = 255, kKept = 38;
  std::string result;
  for (size_t begin = 0; begin < text.size();) {
    const size_t end = std::min(text.find(' ', begin), text.size());
    if (end - begin <= kLongest) {
      result += text.substr(begin, end - begin);
    } else {
      result += text.substr(begin, kKept) + "..." + text.substr(end - kKept, kKept);
    }
    if (end < text.size()) result += ' ';
    begin = end + 1;
  }
  return result;
}

std::string sentence(const ErrorParts& parts) {
  std::string text;
  if (!parts.where.empty()) text += parts.where + ": ";
  if (!parts.expected.empty()) text += "expected " + parts.expected;
  if (!parts.found.empty()) text += (parts.expected.empty() ? "found " : ", found ") + parts.found;
  if (!parts.remedy.empty()) {
    if (!parts.expected.empty() || !parts.found.empty()) text += "; ";
    text += parts.remedy;
  }
  if (!text.empty() && text.back() != '.' && text.back() != '?') text += '.';
  // Names and values of unknown origin are part of it; a newline or an escape of the terminal must not be.
  return printable_text(with_short_words(text));
}

}  // namespace

Error::Error(const ErrorParts& parts) : std::runtime_error(sentence(parts)), parts_(parts) {}

void fail(const ErrorParts& parts) { throw Error(parts); }

}  // namespace gld
