#include "gld/report/table.h"

#include "gld/base/error.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {
namespace {

std::string csv_text(const TableCell& cell) {
  if (const auto* integer = std::get_if<int64_t>(&cell)) return std::to_string(*integer);
  if (const auto* real = std::get_if<double>(&cell)) return fmt::format("{}", *real);
  const auto& text = std::get<std::string>(cell);
  if (text.find_first_of(",\"\r\n") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) {
    if (c == '"') quoted += '"';
    quoted += c;
  }
  return quoted + "\"";
}

std::string markdown_text(const TableCell& cell) {
  if (const auto* integer = std::get_if<int64_t>(&cell)) return std::to_string(*integer);
  if (const auto* real = std::get_if<double>(&cell)) return short_number(*real);
  std::string text;
  for (const char c : std::get<std::string>(cell)) {
    if (c == '|') text += '\\';
    text += c == '\n' ? ' ' : c;
  }
  return text;
}

}  // namespace

Table::Table(std::vector<std::string> columns) : columns_(std::move(columns)) {}

void Table::add_row(std::vector<TableCell> row) {
  if (row.size() != columns_.size()) {
    fail({"table", fmt::format("{} cells in a row", columns_.size()), std::to_string(row.size()), ""});
  }
  rows_.push_back(std::move(row));
}

std::string Table::csv() const {
  std::string text = fmt::format("{}\n", fmt::join(columns_, ","));
  for (const auto& row : rows_) {
    for (size_t i = 0; i < row.size(); ++i) text += (i > 0 ? "," : "") + csv_text(row[i]);
    text += '\n';
  }
  return text;
}

std::string Table::markdown() const {
  std::vector<size_t> widths;
  std::vector<bool> numeric;
  for (size_t i = 0; i < columns_.size(); ++i) {
    size_t width = std::max<size_t>(3, columns_[i].size());
    bool numbers = !rows_.empty();
    for (const auto& row : rows_) {
      width = std::max(width, markdown_text(row[i]).size());
      const auto* text = std::get_if<std::string>(&row[i]);
      numbers = numbers && (text == nullptr || text->empty());
    }
    widths.push_back(width);
    numeric.push_back(numbers);
  }
  const auto padded = [&](const std::string& text, size_t i) {
    return numeric[i] ? fmt::format(" {:>{}} |", text, widths[i]) : fmt::format(" {:<{}} |", text, widths[i]);
  };
  std::string text = "|";
  for (size_t i = 0; i < columns_.size(); ++i) text += padded(columns_[i], i);
  text += "\n|";
  for (size_t i = 0; i < columns_.size(); ++i) {
    text += " " + std::string(widths[i] - 1, '-') + (numeric[i] ? ": |" : "- |");
  }
  text += '\n';
  for (const auto& row : rows_) {
    text += '|';
    for (size_t i = 0; i < row.size(); ++i) text += padded(markdown_text(row[i]), i);
    text += '\n';
  }
  return text;
}

std::string short_number(double value) { return fmt::format("{:.3g}", value); }

}  // namespace gld
