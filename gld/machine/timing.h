#pragma once

#include <functional>
#include <vector>

namespace gld {

// Returns the wall-clock seconds of one call.
double seconds_of(const std::function<void()>& action);

// Returns the fastest of some calls after one that warms up, in seconds: there are at least two calls, then more until
// 0.2 s are spent or 15 were made. It is for forecasts: other programs that disturb some of the calls must not make
// them slower.
double fastest_seconds_of(const std::function<void()>& action);

struct Spread {
  double median = 0;
  double low = 0;   // smallest
  double high = 0;  // largest
};
// values: at least one.
Spread spread_of(std::vector<double> values);

}  // namespace gld
