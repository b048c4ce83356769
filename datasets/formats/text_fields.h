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

// The lines of a text file without their ends, made one at a time: a file of nothing but line ends would otherwise take
// fifty times its size.
class TextLines {
 public:
  class Iterator {
   public:
    using value_type = TextLine;
    const TextLine& operator*() const { return line_; }
    const TextLine* operator->() const { return &line_; }
    Iterator& operator++() {
      next();
      return *this;
    }
    bool operator!=(const Iterator& other) const { return at_ != other.at_; }

   private:
    friend class TextLines;
    void next();
    const TextLines* lines_ = nullptr;
    size_t at_ = std::string::npos;  // where line_ starts; npos behind the last one
    size_t end_ = 0;                 // where the next one starts
    int64_t number_ = 0;
    TextLine line_;
  };

  Iterator begin() const;
  Iterator end() const { return {}; }
  bool empty() const { return content_.empty(); }

 private:
  friend TextLines read_lines(const std::filesystem::path& file);
  std::string file_;
  std::string content_;
};

// Throws Error when the file cannot be read, is no text (holds a zero byte) or is larger than 1 GiB.
TextLines read_lines(const std::filesystem::path& file);

// Returns the runs of characters between blanks, the first `most` of them.
std::vector<std::string> blank_separated(const std::string& text, size_t most = 65536);

// Returns the fields between commas; a field in double quotes may contain commas.
std::vector<std::string> comma_separated(const std::string& text);

// Returns the whole field as a number ("nan" and "inf" are numbers here, checked elsewhere); throws Error otherwise.
double parse_number(const std::string& field, const std::string& where);
int64_t parse_integer(const std::string& field, const std::string& where);

// Returns fields[first .. first + count) as numbers; throws Error when there are too few.
std::vector<double> parse_numbers(const std::vector<std::string>& fields, size_t first, size_t count,
                                  const std::string& where);

}  // namespace gld
