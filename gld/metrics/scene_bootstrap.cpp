#include "gld/metrics/scene_bootstrap.h"

#include "gld/base/mixed_bits.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>

namespace gld {
namespace {

// Linear between the two nearest of the sorted values.
double percentile(const std::vector<double>& sorted, double share) {
  const double place = share * static_cast<double>(sorted.size() - 1);
  const auto below = static_cast<size_t>(place);
  const size_t above = std::min(below + 1, sorted.size() - 1);
  return sorted[below] + (place - static_cast<double>(below)) * (sorted[above] - sorted[below]);
}

}  // namespace

MeanInterval bootstrap_mean_interval(const std::vector<double>& values, uint64_t seed, int64_t resamples) {
  std::vector<double> finite;
  std::copy_if(values.begin(), values.end(), std::back_inserter(finite),
               [](double value) { return std::isfinite(value); });
  if (finite.size() < 2) {
    return {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::quiet_NaN()};
  }
  std::vector<double> means;
  uint64_t random = mixed_bits(seed);
  for (int64_t i = 0; i < resamples; ++i) {
    double sum = 0;
    for (size_t drawn = 0; drawn < finite.size(); ++drawn)
      sum += finite[mixed_bits(random++) % finite.size()];
    means.push_back(sum / static_cast<double>(finite.size()));
  }
  std::sort(means.begin(), means.end());
  return {percentile(means, 0.025), percentile(means, 0.975)};
}

}  // namespace gld
