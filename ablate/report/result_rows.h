#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

namespace gld {

// A table of text cells under named columns: what gld eval and gld bench write as CSV (RFC 4180). A report.json is one
// row whose columns are its numbers and texts by their path, "methods.sample.guidance_scale"; in lists of stages by the
// stage's name, "stages.M1.seconds".
struct ResultRows {
  std::filesystem::path file;
  std::vector<std::string> columns;
  std::vector<std::vector<std::string>> rows;
};

// Throws Error naming file and line where a row has another number of cells than there are columns, or a quote is not
// closed.
ResultRows read_result_rows(const std::filesystem::path& file);

bool has_column(const ResultRows& rows, const std::string& name);

// Returns whether a row has these texts in these columns.
bool any_row(const ResultRows& rows, const std::map<std::string, std::string>& where);

// Returns a column's numbers by scene and, where there is a column "target", by target view: those of the rows that
// have these texts in these columns. Empty cells are left out: the quantity is absent. Several rows of one scene and
// view are averaged; files without a column of scenes are of one, "all". Throws Error where a column does not exist,
// naming the nearest, a cell is no number, or no row is left.
std::map<std::string, std::map<std::string, double>> numbers_by_scene(
    const ResultRows& rows, const std::string& column, const std::map<std::string, std::string>& where);

}  // namespace gld
