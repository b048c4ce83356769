#include "datasets/formats/text_fields.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"

#include <algorithm>
#include <charconv>

namespace gld {

TextLines read_lines(const std::filesystem::path& file) {
  constexpr uint64_t kLargestText = uint64_t{1} << 30;
  TextLines lines;
  lines.file_ = file.string();
  lines.content_ = read_file(file, kLargestText);
  if (lines.content_.find('\0') != std::string::npos) {
    fail({file.string(), "a text file", "binary data", "check that it is the right file"});
  }
  return lines;
}

TextLines::Iterator TextLines::begin() const {
  Iterator first;
  first.lines_ = this;
  first.next();
  return first;
}

void TextLines::Iterator::next() {
  const std::string& content = lines_->content_;
  at_ = end_;
  if (at_ >= content.size()) {
    at_ = std::string::npos;
    return;
  }
  const size_t found = content.find('\n', at_);
  const size_t stop = found == std::string::npos ? content.size() : found;
  end_ = stop + 1;
  const bool carriage_return = stop > at_ && content[stop - 1] == '\r';
  line_.text.assign(content, at_, stop - at_ - (carriage_return ? 1 : 0));
  line_.where = lines_->file_ + ":" + std::to_string(++number_);
}

std::vector<std::string> blank_separated(const std::string& text, size_t most) {
  constexpr const char* kBlanks = " \t\v\f\r\n";
  std::vector<std::string> fields;
  for (size_t start = text.find_first_not_of(kBlanks); start != std::string::npos && fields.size() < most;) {
    const size_t end = std::min(text.find_first_of(kBlanks, start), text.size());
    fields.push_back(text.substr(start, end - start));
    start = text.find_first_not_of(kBlanks, end);
  }
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
