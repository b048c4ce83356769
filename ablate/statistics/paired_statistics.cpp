#include "ablate/statistics/paired_statistics.h"

#include "gld/base/mixed_bits.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <vector>

namespace gld {
namespace {

constexpr double kNoNumber = std::numeric_limits<double>::quiet_NaN();

// Uniform in [0, count): the upper bits of a counter's mixed bits. For counts of scenes the bias is below 2^-40.
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

// Between neighbours, as R's type 7: quantiles of negated values are the negated opposite quantiles.
double quantile(const std::vector<double>& sorted, double share) {
  const double place = share * static_cast<double>(sorted.size() - 1);
  const auto below = static_cast<size_t>(place);
  if (below + 1 >= sorted.size()) return sorted.back();
  const double part = place - static_cast<double>(below);
  return sorted[below] * (1 - part) + sorted[below + 1] * part;
}

// Rows are seeds, columns scenes; NaN where that seed has no number of that scene.
std::vector<std::vector<double>> as_matrix(const NumbersBySeed& numbers) {
  std::set<std::string> scenes;
  for (const auto& [seed, values] : numbers) {
    for (const auto& [scene, value] : values) scenes.insert(scene);
  }
  std::vector<std::vector<double>> matrix;
  for (const auto& [seed, values] : numbers) {
    std::vector<double> row;
    for (const std::string& scene : scenes) {
      const auto found = values.find(scene);
      row.push_back(found == values.end() ? kNoNumber : found->second);
    }
    matrix.push_back(std::move(row));
  }
  return matrix;
}

}  // namespace

NumbersBySeed paired_differences(const NumbersBySeed& first, const NumbersBySeed& second) {
  NumbersBySeed differences;
  for (const auto& [seed, values] : first) {
    const auto others = second.find(seed);
    if (others == second.end()) continue;
    for (const auto& [scene, value] : values) {
      const auto other = others->second.find(scene);
      if (other == others->second.end()) continue;
      if (std::isfinite(value) && std::isfinite(other->second)) {
        differences[seed][scene] = value - other->second;
      }
    }
  }
  return differences;
}

int64_t scene_count(const NumbersBySeed& numbers) {
  std::set<std::string> scenes;
  for (const auto& [seed, values] : numbers) {
    for (const auto& [scene, value] : values) scenes.insert(scene);
  }
  return static_cast<int64_t>(scenes.size());
}

double mean_of_seed_means(const NumbersBySeed& numbers) {
  double sum = 0;
  int64_t seeds = 0;
  for (const auto& [seed, values] : numbers) {
    if (values.empty()) continue;
    double of_seed = 0;
    for (const auto& [scene, value] : values) of_seed += value;
    sum += of_seed / static_cast<double>(values.size());
    ++seeds;
  }
  return seeds == 0 ? kNoNumber : sum / static_cast<double>(seeds);
}

Interval bootstrap_interval(const NumbersBySeed& numbers, const BootstrapOptions& options) {
  const auto matrix = as_matrix(numbers);
  const size_t seeds = matrix.size();
  const size_t scenes = seeds == 0 ? 0 : matrix.front().size();
  if (scenes == 0) return {kNoNumber, kNoNumber};
  Draws draws(options.seed);
  std::vector<double> means;
  means.reserve(static_cast<size_t>(options.replicates));
  std::vector<size_t> drawn(scenes);
  for (int64_t replicate = 0; replicate < options.replicates; ++replicate) {
    for (size_t& scene : drawn) scene = draws.below(scenes);
    double sum = 0;
    int64_t counted = 0;
    for (size_t draw = 0; draw < seeds; ++draw) {
      const std::vector<double>& row = matrix[draws.below(seeds)];
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
  if (means.empty()) return {kNoNumber, kNoNumber};
  std::sort(means.begin(), means.end());
  const double tail = (1 - options.coverage) / 2;
  return {quantile(means, tail), quantile(means, 1 - tail)};
}

SignTest sign_test(const NumbersBySeed& differences) {
  std::map<std::string, double> sums;  // the sign of a scene's mean is that of its sum
  for (const auto& [seed, values] : differences) {
    for (const auto& [scene, value] : values) sums[scene] += value;
  }
  SignTest test;
  for (const auto& [scene, sum] : sums) {
    if (sum > 0) {
      ++test.positive;
    } else if (sum < 0) {
      ++test.negative;
    } else {
      ++test.ties;
    }
  }
  test.p_value = sign_test_p_value(test.positive, test.negative);
  return test;
}

double sign_test_p_value(int64_t positive, int64_t negative) {
  const int64_t trials = positive + negative;
  const int64_t fewer = std::min(positive, negative);
  // log of the binomial coefficient over 2^trials, from one term to the next: no factorial overflows.
  double log_term = -static_cast<double>(trials) * std::log(2.0);
  double tail = 0;
  for (int64_t successes = 0; successes <= fewer; ++successes) {
    tail += std::exp(log_term);
    log_term += std::log(static_cast<double>(trials - successes) / static_cast<double>(successes + 1));
  }
  return std::min(1.0, 2 * tail);
}

}  // namespace gld
