#include "ablate/report/result_rows.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/json_text.h"

#include <algorithm>
#include <charconv>
#include <limits>
#include <optional>
#include <utility>

#include <nlohmann/json.hpp>

namespace gld {
namespace {

// Returns the cells of all lines. A quoted cell may hold commas, line ends and doubled quotes.
std::vector<std::vector<std::string>> csv_cells(const std::string& text, const std::string& where) {
  std::vector<std::vector<std::string>> lines(1);
  std::string cell;
  bool quoted = false;
  bool any = false;  // whether the line has anything
  const auto end_cell = [&] {
    lines.back().push_back(std::move(cell));
    cell.clear();
  };
  for (size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (quoted) {
      if (c != '"') {
        cell += c;
      } else if (i + 1 < text.size() && text[i + 1] == '"') {
        cell += text[++i];
      } else {
        quoted = false;
      }
      continue;
    }
    if (c == '\r') continue;
    if (c == '\n') {
      if (any) {
        end_cell();
        lines.emplace_back();
      }
      any = false;
      continue;
    }
    any = true;
    if (c == '"') {
      quoted = true;
    } else if (c == ',') {
      end_cell();
    } else {
      cell += c;
    }
  }
  if (quoted) {
    fail({where + ":" + std::to_string(lines.size()), "a quote that is closed", "the end of the file",
          "write it again"});
  }
  if (any) {
    end_cell();
  } else {
    lines.pop_back();
  }
  return lines;
}

size_t column_number(const ResultRows& rows, const std::string& name) {
  const auto found = std::find(rows.columns.begin(), rows.columns.end(), name);
  if (found == rows.columns.end()) {
    const auto near = nearest_name(name, rows.columns);
    fail({rows.file.string(), "a column '" + name + "'", "none",
          near.empty() ? "choose one of its first line" : "did you mean '" + near + "'?"});
  }
  return static_cast<size_t>(found - rows.columns.begin());
}

// In a report the column is "scene.name". Files of means over scenes have none: they are one scene.
std::optional<size_t> scene_column_of(const ResultRows& rows) {
  for (const char* name : {"scene.name", "scene"}) {
    if (has_column(rows, name)) return column_number(rows, name);
  }
  return std::nullopt;
}

double number_in(const std::string& cell, const std::string& where) {
  if (cell == "inf") return std::numeric_limits<double>::infinity();
  if (cell == "-inf") return -std::numeric_limits<double>::infinity();
  if (cell == "nan") return std::numeric_limits<double>::quiet_NaN();
  double value = 0;
  const auto parsed = std::from_chars(cell.data(), cell.data() + cell.size(), value);
  if (parsed.ec != std::errc() || parsed.ptr != cell.data() + cell.size()) {
    fail({where, "a number", "'" + cell + "'", "choose another column, or run the stage again"});
  }
  return value;
}

void add_leaves(const nlohmann::json& value, const std::string& path, ResultRows& rows) {
  const std::string prefix = path.empty() ? "" : path + ".";
  if (value.is_object()) {
    for (const auto& [name, inner] : value.items()) add_leaves(inner, prefix + name, rows);
  } else if (value.is_array()) {
    for (const auto& inner : value) {
      if (inner.is_object() && inner.contains("stage") && inner.at("stage").is_string()) {
        add_leaves(inner, prefix + inner.at("stage").get<std::string>(), rows);
      }
    }
  } else {
    rows.columns.push_back(path);
    rows.rows.front().push_back(value.is_string() ? value.get<std::string>()
                                : value.is_null() ? ""
                                                  : json_text(value));
  }
}

// Columns by number, and the texts that a row must have in them.
using Conditions = std::vector<std::pair<size_t, std::string>>;

Conditions conditions_of(const ResultRows& rows, const std::map<std::string, std::string>& where) {
  Conditions conditions;
  conditions.reserve(where.size());
  for (const auto& [name, text] : where) conditions.emplace_back(column_number(rows, name), text);
  return conditions;
}

bool meets(const std::vector<std::string>& row, const Conditions& conditions) {
  return std::all_of(conditions.begin(), conditions.end(),
                     [&](const auto& condition) { return row[condition.first] == condition.second; });
}

}  // namespace

bool any_row(const ResultRows& rows, const std::map<std::string, std::string>& where) {
  const Conditions conditions = conditions_of(rows, where);
  return std::any_of(rows.rows.begin(), rows.rows.end(),
                     [&](const auto& row) { return meets(row, conditions); });
}

bool has_column(const ResultRows& rows, const std::string& name) {
  return std::find(rows.columns.begin(), rows.columns.end(), name) != rows.columns.end();
}

ResultRows read_result_rows(const std::filesystem::path& file) {
  if (file.extension() == ".json") {
    ResultRows report;
    report.file = file;
    report.rows.emplace_back();
    add_leaves(parse_json(read_file(file), file.string()), "", report);
    return report;
  }
  auto lines = csv_cells(read_file(file), file.string());
  if (lines.empty())
    fail({file.string(), "a line with the names of columns", "an empty file", "run the stage again"});
  ResultRows rows;
  rows.file = file;
  rows.columns = std::move(lines.front());
  for (size_t line = 1; line < lines.size(); ++line) {
    if (lines[line].size() != rows.columns.size()) {
      fail({file.string() + ":" + std::to_string(line + 1), std::to_string(rows.columns.size()) + " cells",
            std::to_string(lines[line].size()), "run the stage again"});
    }
    rows.rows.push_back(std::move(lines[line]));
  }
  return rows;
}

std::map<std::string, std::map<std::string, double>> numbers_by_scene(
    const ResultRows& rows, const std::string& column, const std::map<std::string, std::string>& where) {
  const size_t value_column = column_number(rows, column);
  const std::optional<size_t> scene_column = scene_column_of(rows);
  const auto target = std::find(rows.columns.begin(), rows.columns.end(), "target");
  const Conditions conditions = conditions_of(rows, where);
  struct Sum {
    double sum = 0;
    int64_t count = 0;
  };
  std::map<std::string, std::map<std::string, Sum>> sums;
  bool any = false;
  for (size_t number = 0; number < rows.rows.size(); ++number) {
    const auto& row = rows.rows[number];
    if (!meets(row, conditions)) continue;
    any = true;
    if (row[value_column].empty()) continue;
    const std::string view =
        target == rows.columns.end() ? "" : row[static_cast<size_t>(target - rows.columns.begin())];
    Sum& sum = sums[scene_column ? row[*scene_column] : "all"][view];
    sum.sum += number_in(row[value_column],
                         rows.file.string() + ":" + std::to_string(number + 2) + ", column '" + column + "'");
    ++sum.count;
  }
  if (!any) {
    std::string conditions_text;
    for (const auto& [name, text] : where) {
      if (!conditions_text.empty()) conditions_text += " and ";
      conditions_text += name;
      conditions_text += " ";
      conditions_text += text;
    }
    fail({rows.file.string(), conditions_text.empty() ? "rows" : "rows with " + conditions_text, "none",
          "see what the file has"});
  }
  std::map<std::string, std::map<std::string, double>> numbers;
  for (const auto& [scene, views] : sums) {
    for (const auto& [view, sum] : views) numbers[scene][view] = sum.sum / static_cast<double>(sum.count);
  }
  return numbers;
}

}  // namespace gld
