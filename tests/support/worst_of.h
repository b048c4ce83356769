#pragma once

#include <cmath>
#include <limits>

namespace gld::test {

// Returns the larger error, and infinity where one is not a number: std::max would keep what it had.
inline double worst_of(double worst, double error) {
  if (std::isnan(worst) || std::isnan(error)) return std::numeric_limits<double>::infinity();
  return error > worst ? error : worst;
}

}  // namespace gld::test
