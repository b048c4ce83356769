#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace gld {

// One line of a text file and where it stands ("FILE:12").
struct TextLine {
  std::string text;
  std::string where;
};

// Lines without their ends; Error when the file cannot be read or is no text (holds a zero byte).
std::vector<TextLine> read_lines(const std::filesystem::path& file);

// Runs of characters between blanks.
std::vector<std::string> blank_separated(const std::string& text);

// Fields between commas; a field in double quotes may contain commas.
std::vector<std::string> comma_separated(const std::string& text);

// The whole field as a number ("nan" and "inf" are numbers here, checked elsewhere); Error otherwise.
double parse_number(const std::string& field, const std::string& where);
int64_t parse_integer(const std::string& field, const std::string& where);

// fields[first .. first + count) as numbers; Error when there are too few.
std::vector<double> parse_numbers(const std::vector<std::string>& fields, size_t first, size_t count,
                                  const std::string& where);

}  // namespace gld
