#pragma once

#include <functional>
#include <vector>

namespace gld {

// Wall-clock seconds of one call.
double seconds_of(const std::function<void()>& action);

struct Spread {
  double median = 0;
  double low = 0;   // smallest
  double high = 0;  // largest
};
// values: at least one.
Spread spread_of(std::vector<double> values);

}  // namespace gld
