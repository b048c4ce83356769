#include "gld/base/printable_text.h"

#include <cstdint>
#include <cstdio>

namespace gld {
namespace {

struct Character {
  uint32_t code = 0;
  size_t bytes = 0;  // 0: no UTF-8 here
};

Character character_at(const std::string& text, size_t position) {
  const auto byte = [&](size_t i) { return static_cast<uint8_t>(text[position + i]); };
  const uint8_t first = byte(0);
  if (first < 0x80) return {first, 1};
  const size_t length = first >= 0xF0 ? 4 : first >= 0xE0 ? 3 : 2;
  // 0xC0 and 0xC1 would be longer forms of ASCII; 0xF5 and above lie beyond the last character.
  if (first < 0xC2 || first > 0xF4 || length > text.size() - position) return {};
  uint32_t code = first & (0xFF >> (length + 1));
  for (size_t i = 1; i < length; ++i) {
    if ((byte(i) & 0xC0) != 0x80) return {};
    code = code << 6 | (byte(i) & 0x3F);
  }
  const uint32_t smallest[] = {0, 0, 0x80, 0x800, 0x10000};
  const bool surrogate = code >= 0xD800 && code <= 0xDFFF;
  if (code < smallest[length] || code > 0x10FFFF || surrogate) return {};
  return {code, length};
}

bool turns_direction(uint32_t code) {
  return (code >= 0x202A && code <= 0x202E) || (code >= 0x2066 && code <= 0x2069) || code == 0x200E ||
         code == 0x200F || code == 0x061C;
}

// U+2028 and U+2029 end lines.
bool obeyed_by_terminals(uint32_t code) {
  return code < 0x20 || (code >= 0x7F && code < 0xA0) || code == 0x2028 || code == 0x2029 ||
         turns_direction(code);
}

std::string escaped(uint32_t code) {
  if (code == '\n') return "\\n";
  if (code == '\r') return "\\r";
  if (code == '\t') return "\\t";
  char text[16];
  std::snprintf(text, sizeof text, code < 0x100 ? "\\x%02x" : "\\u%04x", static_cast<unsigned>(code));
  return text;
}

}  // namespace

std::string printable_text(const std::string& text) {
  std::string printable;
  printable.reserve(text.size());
  for (size_t position = 0; position < text.size();) {
    const Character character = character_at(text, position);
    if (character.bytes == 0) {
      printable += escaped(static_cast<uint8_t>(text[position++]));
      continue;
    }
    printable += obeyed_by_terminals(character.code) ? escaped(character.code)
                                                     : text.substr(position, character.bytes);
    position += character.bytes;
  }
  return printable;
}

std::string printable_text(const std::string& text, size_t most) {
  if (text.size() <= most) return printable_text(text);
  size_t end = most;
  while (end > 0 && (static_cast<uint8_t>(text[end]) & 0xC0) == 0x80 && most - end < 3) --end;
  return printable_text(text.substr(0, end)) + "...";
}

}  // namespace gld
