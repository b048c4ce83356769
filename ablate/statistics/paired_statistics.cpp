#include "ablate/statistics/paired_statistics.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <set>
#include <vector>

#include <unsupported/Eigen/SpecialFunctions>

namespace gld {
namespace {

constexpr double kNoNumber = std::numeric_limits<double>::quiet_NaN();

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

BootstrapTest test_of_seed_means(const NumbersBySeed& numbers, const BootstrapOptions& options) {
  return bootstrap_test(as_matrix(numbers), options);
}

double seed_means_p_value(const NumbersBySeed& numbers) {
  std::vector<double> means;
  for (const auto& [seed, values] : numbers) {
    if (!values.empty()) means.push_back(mean_of_seed_means({{seed, values}}));
  }
  if (means.size() < 2) return 1;
  const auto count = static_cast<double>(means.size());
  const double mean = std::accumulate(means.begin(), means.end(), 0.0) / count;
  double squares = 0;
  for (const double value : means) squares += (value - mean) * (value - mean);
  if (mean == 0) return 1;
  const double freedom = count - 1;
  const double t_squared = count * mean * mean / (squares / freedom);
  // The p-value is P(|T| > t) = I_x(freedom / 2, 1 / 2) at x = freedom / (freedom + t^2), which is 0 where all means
  // are equal.
  return Eigen::numext::betainc(freedom / 2, 0.5, freedom / (freedom + t_squared));
}

std::vector<double> holm_p_values(const std::vector<double>& p_values) {
  std::vector<size_t> order(p_values.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) { return p_values[a] < p_values[b]; });
  std::vector<double> corrected(p_values.size());
  double largest = 0;
  for (size_t rank = 0; rank < order.size(); ++rank) {
    const double factor = static_cast<double>(order.size() - rank);
    largest = std::max(largest, std::min(1.0, factor * p_values[order[rank]]));
    corrected[order[rank]] = largest;
  }
  return corrected;
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
