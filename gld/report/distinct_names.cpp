#include "gld/report/distinct_names.h"

namespace gld {

std::string DistinctNames::of(const std::string& name) {
  std::string distinct = name;
  for (int number = 2; !taken_.insert(distinct).second; ++number)
    distinct = name + "_" + std::to_string(number);
  return distinct;
}

}  // namespace gld
