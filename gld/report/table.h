#pragma once

#include <cstdint>
#include <string>
#include <variant>
#include <vector>

namespace gld {

// A cell without a value is empty text.
using TableCell = std::variant<std::string, int64_t, double>;

// Rows under named columns, written as CSV for programs and Markdown for readers.
class Table {
 public:
  explicit Table(std::vector<std::string> columns);

  // Throws Error when the row's length is not the number of columns.
  void add_row(std::vector<TableCell> row);

  const std::vector<std::string>& columns() const { return columns_; }
  const std::vector<std::vector<TableCell>>& rows() const { return rows_; }

  // Returns CSV of RFC 4180 with '\n' line ends, and numbers with as many digits as they need to be read back exactly,
  // "nan", "inf".
  std::string csv() const;
  // Returns a pipe table, with columns aligned and numbers with three digits and to the right.
  std::string markdown() const;

 private:
  std::vector<std::string> columns_;
  std::vector<std::vector<TableCell>> rows_;
};

// Returns three significant digits, as tables and plots show numbers: "0.0123", "1.5e-07", "1.2e+05".
std::string short_number(double value);

}  // namespace gld
