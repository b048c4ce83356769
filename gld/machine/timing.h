#pragma once

#include <functional>
#include <vector>

namespace gld {

// Wall-clock seconds of one call.
double seconds_of(const std::function<void()>& action);

// The fastest of some calls after one that warms up, in seconds: at least two calls, then until 0.2 s are spent or 15
// were made. For forecasts: other programs that disturb some of the calls must not make them slower.
double fastest_seconds_of(const std::function<void()>& action);

struct Spread {
  double median = 0;
  double low = 0;   // smallest
  double high = 0;  // largest
};
// values: at least one.
Spread spread_of(std::vector<double> values);

}  // namespace gld
