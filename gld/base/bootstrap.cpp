#include "gld/base/bootstrap.h"

#include "gld/base/mixed_bits.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

namespace gld {
namespace {

constexpr double kNoNumber = std::numeric_limits<double>::quiet_NaN();

// Numbers are drawn uniformly in [0, count), from the upper bits of a counter's mixed bits. For counts of scenes the
// bias is below 2^-40.
class Draws {
 public:
  explicit Draws(uint64_t seed) : state_(mixed_bits(seed)) {}
  size_t below(size_t count) {
    state_ += kSplitMixIncrement;
    const auto share = static_cast<double>(mixed_bits(state_) >> 11U) * 0x1.0p-53;
    return std::min(count - 1, static_cast<size_t>(share * static_cast<double>(count)));
  }

 private:
  uint64_t state_;
};

// Interpolates between neighbours, as R's type 7 does: quantiles of negated values are the negated opposite quantiles.
double quantile(const std::vector<double>& sorted, double share) {
  const double place = share * static_cast<double>(sorted.size() - 1);
  const auto below = static_cast<size_t>(place);
  if (below + 1 >= sorted.size()) return sorted.back();
  const double part = place - static_cast<double>(below);
  return sorted[below] * (1 - part) + sorted[below + 1] * part;
}

// Returns the mean of every replicate, in order of size; the list is empty without numbers.
std::vector<double> replicate_means(const std::vector<std::vector<double>>& numbers,
                                    const BootstrapOptions& options) {
  const size_t seeds = numbers.size();
  const size_t scenes = seeds == 0 ? 0 : numbers.front().size();
  if (scenes == 0) return {};
  Draws draws(options.seed);
  std::vector<double> means;
  means.reserve(static_cast<size_t>(options.replicates));
  std::vector<size_t> drawn(scenes);
  for (int64_t replicate = 0; replicate < options.replicates; ++replicate) {
    for (size_t& scene : drawn) scene = draws.below(scenes);
    double sum = 0;
    int64_t counted = 0;
    for (size_t draw = 0; draw < seeds; ++draw) {
      const std::vector<double>& row = numbers[draws.below(seeds)];
      double of_seed = 0;
      int64_t of_scenes = 0;
      for (const size_t scene : drawn) {
        if (std::isnan(row[scene])) continue;
        of_seed += row[scene];
        ++of_scenes;
      }
      if (of_scenes == 0) continue;
      sum += of_seed / static_cast<double>(of_scenes);
      ++counted;
    }
    if (counted > 0) means.push_back(sum / static_cast<double>(counted));
  }
  std::sort(means.begin(), means.end());
  return means;
}

}  // namespace

BootstrapTest bootstrap_test(const std::vector<std::vector<double>>& numbers,
                             const BootstrapOptions& options) {
  const std::vector<double> means = replicate_means(numbers, options);
  BootstrapTest test;
  if (means.empty()) {
    test.interval = {kNoNumber, kNoNumber};
    return test;
  }
  const double tail = (1 - options.coverage) / 2;
  test.interval = {quantile(means, tail), quantile(means, 1 - tail)};
  const auto not_above = std::upper_bound(means.begin(), means.end(), 0.0) - means.begin();
  const auto not_below = means.end() - std::lower_bound(means.begin(), means.end(), 0.0);
  const auto rarer = static_cast<double>(std::min(not_above, not_below) + 1);
  test.p_value = std::min(1.0, 2 * rarer / static_cast<double>(means.size() + 1));
  return test;
}

Interval bootstrap_interval(const std::vector<std::vector<double>>& numbers,
                            const BootstrapOptions& options) {
  return bootstrap_test(numbers, options).interval;
}

}  // namespace gld
