#pragma once

#include <sstream>
#include <string>
#include <vector>

namespace gld::test {

// Returns the cells of a line of CSV without quotes.
inline std::vector<std::string> csv_cells(const std::string& line) {
  std::vector<std::string> cells;
  std::istringstream text(line + ",");
  for (std::string cell; std::getline(text, cell, ',');) cells.push_back(cell);
  return cells;
}

}  // namespace gld::test
