#include "datasets/formats/text_fields.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"

#include <charconv>
#include <sstream>

namespace gld {

std::vector<TextLine> read_lines(const std::filesystem::path& file) {
  const std::string content = read_file(file);
  if (content.find('\0') != std::string::npos) {
    fail({file.string(), "a text file", "binary data", "check that it is the right file"});
  }
  std::vector<TextLine> lines;
  std::istringstream stream(content);
  std::string text;
  while (std::getline(stream, text)) {
    if (!text.empty() && text.back() == '\r') text.pop_back();
    lines.push_back({text, file.string() + ":" + std::to_string(lines.size() + 1)});
  }
  return lines;
}

std::vector<std::string> blank_separated(const std::string& text) {
  std::vector<std::string> fields;
  std::istringstream stream(text);
  std::string field;
  while (stream >> field) fields.push_back(field);
  return fields;
}

std::vector<std::string> comma_separated(const std::string& text) {
  std::vector<std::string> fields(1);
  bool quoted = false;
  for (const char c : text) {
    if (c == '"') {
      quoted = !quoted;
    } else if (c == ',' && !quoted) {
      fields.emplace_back();
    } else {
      fields.back() += c;
    }
  }
  return fields;
}

double parse_number(const std::string& field, const std::string& where) {
  double value = 0;
  const char* end = field.data() + field.size();
  const auto [stopped, error] = std::from_chars(field.data(), end, value);
  if (error != std::errc() || stopped != end) {
    fail({where, "a number", "\"" + field + "\"", "correct the file"});
  }
  return value;
}

int64_t parse_integer(const std::string& field, const std::string& where) {
  int64_t value = 0;
  const char* end = field.data() + field.size();
  const auto [stopped, error] = std::from_chars(field.data(), end, value);
  if (error != std::errc() || stopped != end) {
    fail({where, "an integer", "\"" + field + "\"", "correct the file"});
  }
  return value;
}

std::vector<double> parse_numbers(const std::vector<std::string>& fields, size_t first, size_t count,
                                  const std::string& where) {
  if (fields.size() < first + count) {
    fail({where, "at least " + std::to_string(first + count) + " fields", std::to_string(fields.size()),
          "correct the file"});
  }
  std::vector<double> numbers;
  for (size_t i = first; i < first + count; ++i) numbers.push_back(parse_number(fields[i], where));
  return numbers;
}

}  // namespace gld
