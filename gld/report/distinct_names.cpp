#include "gld/report/distinct_names.h"

#include <algorithm>

namespace gld {

std::string DistinctNames::of(const std::string& name) {
  std::string file = name;
  std::replace(file.begin(), file.end(), '/', '_');
  std::string distinct = file;
  for (int number = 2; !taken_.insert(distinct).second; ++number)
    distinct = file + "_" + std::to_string(number);
  return distinct;
}

}  // namespace gld
