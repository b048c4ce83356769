#include "bench/support/benchmark_precisions.h"

#include "gld/base/error.h"

#include <algorithm>

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace gld {

std::vector<ComputePrecision> benchmark_precisions(const std::vector<std::string>& names) {
  std::vector<ComputePrecision> precisions{ComputePrecision::kFloat32};
  const auto& known = compute_precision_names();
  for (const auto& name : names) {
    const auto found = std::find(known.begin(), known.end(), name);
    if (found == known.end()) {
      fail(
          {"--precisions", fmt::format("{}", fmt::join(known, ", ")), "'" + name + "'", "choose among them"});
    }
    const auto precision = static_cast<ComputePrecision>(found - known.begin());
    if (std::find(precisions.begin(), precisions.end(), precision) == precisions.end()) {
      precisions.push_back(precision);
    }
  }
  return precisions;
}

}  // namespace gld
