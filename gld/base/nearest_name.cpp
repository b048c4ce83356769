// The distance between names, for suggestions.
#include "gld/base/configuration.h"

#include <algorithm>
#include <cstddef>
#include <string>
#include <vector>

namespace gld {
namespace {

// Counts the letters to change, leave out, put in or swap with their neighbour (Damerau's, restricted).
size_t edit_distance(const std::string& a, const std::string& b) {
  std::vector<size_t> before(b.size() + 1), above(b.size() + 1), row(b.size() + 1);
  for (size_t j = 0; j <= b.size(); ++j) above[j] = j;
  for (size_t i = 1; i <= a.size(); ++i) {
    row[0] = i;
    for (size_t j = 1; j <= b.size(); ++j) {
      row[j] = std::min({above[j] + 1, row[j - 1] + 1, above[j - 1] + (a[i - 1] == b[j - 1] ? 0 : 1)});
      if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1]) {
        row[j] = std::min(row[j], before[j - 2] + 1);
      }
    }
    before.swap(above);
    above.swap(row);
  }
  return above[b.size()];
}

}  // namespace

std::string nearest_name(const std::string& name, const std::vector<std::string>& candidates) {
  // The dashes of flags are no letters.
  const auto letters = [](const std::string& flag) {
    return flag.substr(std::min(flag.find_first_not_of('-'), flag.size()));
  };
  const std::string asked = letters(name);
  std::string best;
  // At most half of the letters may differ: a suggestion that shares less with the name misleads.
  size_t best_distance = std::max<size_t>(1, asked.size() / 2) + 1;
  for (const auto& candidate : candidates) {
    const size_t distance = edit_distance(asked, letters(candidate));
    if (distance < best_distance) {
      best_distance = distance;
      best = candidate;
    }
  }
  return best;
}

}  // namespace gld
