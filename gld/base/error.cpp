#include "gld/base/error.h"

#include "gld/base/printable_text.h"

namespace gld {
namespace {

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
  return printable_text(text);
}

}  // namespace

Error::Error(const ErrorParts& parts) : std::runtime_error(sentence(parts)), parts_(parts) {}

void fail(const ErrorParts& parts) { throw Error(parts); }

}  // namespace gld
