#include "gld/machine/timing.h"

#include <algorithm>
#include <chrono>
#include <limits>

namespace gld {

double seconds_of(const std::function<void()>& action) {
  const auto start = std::chrono::steady_clock::now();
  action();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

double fastest_seconds_of(const std::function<void()>& action) {
  constexpr double kEnough = 0.2;
  constexpr int kFewestCalls = 2, kMostCalls = 15;
  double sum = seconds_of(action), fastest = std::numeric_limits<double>::infinity();
  for (int i = 0; i < kFewestCalls || (sum < kEnough && i < kMostCalls); ++i) {
    const double seconds = seconds_of(action);
    sum += seconds;
    fastest = std::min(fastest, seconds);
  }
  return fastest;
}

Spread spread_of(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const std::size_t middle = values.size() / 2;
  const double median = values.size() % 2 == 1 ? values[middle] : 0.5 * (values[middle - 1] + values[middle]);
  return {median, values.front(), values.back()};
}

}  // namespace gld
