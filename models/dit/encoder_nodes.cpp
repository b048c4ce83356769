#include "models/dit/encoder_nodes.h"

#include <algorithm>
#include <cmath>

namespace gld {
namespace {

bool one_evaluation_a_step(SolverKind solver) {
  constexpr int64_t kMany = 1000;
  return !is_adaptive(solver) && steps_for_evaluations(solver, kMany) >= kMany - 1;
}

// Returns Leja points: the ends, then each time the candidate with the largest product of distances to those chosen.
// Their Lebesgue constant grows slowly whatever the candidates are, which equally spaced points would not give.
std::vector<double> chosen_among(std::vector<double> candidates, int64_t count) {
  const auto most = static_cast<size_t>(count);
  if (candidates.size() <= most) return candidates;
  std::vector<double> chosen{candidates.front(), candidates.back()};
  while (chosen.size() < most) {
    const auto log_distances = [&](double candidate) {
      double sum = 0;
      for (const double node : chosen) sum += std::log(std::max(std::abs(candidate - node), 1e-300));
      return sum;
    };
    chosen.push_back(*std::max_element(candidates.begin(), candidates.end(), [&](double a, double b) {
      return log_distances(a) < log_distances(b);
    }));
  }
  std::sort(chosen.begin(), chosen.end(), std::greater<>());
  return chosen;
}

std::vector<double> chebyshev_points(double high, double low, int64_t count) {
  if (high == low) return {high};
  std::vector<double> points;
  for (int64_t i = 0; i < count; ++i) {
    const double x = 0.5 + 0.5 * std::cos(M_PI * static_cast<double>(i) / static_cast<double>(count - 1));
    points.push_back(low + (high - low) * x);
  }
  points.front() = high;
  points.back() = low;
  return points;
}

}  // namespace

EncoderNodes encoder_nodes_on(const std::vector<double>& times, const SolverOptions& solver,
                              const GuidanceOptions& guidance, int64_t count) {
  EncoderNodes nodes;
  if (one_evaluation_a_step(solver.solver)) {
    const std::vector<double> visited(times.begin(), times.end() - 1);
    nodes[0] = chosen_among(visited, count);
    std::vector<double> inside;
    std::copy_if(visited.begin(), visited.end(), std::back_inserter(inside),
                 [&](double t) { return guidance.acts_at(t); });
    nodes[1] = chosen_among(inside, count);
    return nodes;
  }
  const double first = times.front(), last = times.back();
  nodes[0] = chebyshev_points(first, last, count);
  const double inner_first = std::min(first, guidance.guidance_interval[1]);
  const double inner_last = std::max(last, guidance.guidance_interval[0]);
  if (inner_first >= inner_last && guidance.acts_at(inner_first))
    nodes[1] = chebyshev_points(inner_first, inner_last, count);
  return nodes;
}

EncoderNodes encoder_nodes(const SolverOptions& solver, const GuidanceOptions& guidance, int64_t count) {
  return encoder_nodes_on(solver_times(solver), solver, guidance, count);
}

std::vector<double> interpolation_weights(const std::vector<double>& nodes, double t) {
  // The barycentric form (Berrut and Trefethen 2004, equation 4.2), whose sum is 1 to rounding. Distances are scaled
  // by a quarter of the interval, its capacity, so that the products stay near 1.
  std::vector<double> weights(nodes.size(), 0.0);
  const auto at_node = std::find(nodes.begin(), nodes.end(), t);
  if (at_node != nodes.end()) {
    weights[static_cast<size_t>(at_node - nodes.begin())] = 1;
    return weights;
  }
  const double scale = 4 / std::max(std::abs(nodes.front() - nodes.back()), 1e-300);
  double sum = 0;
  for (size_t i = 0; i < nodes.size(); ++i) {
    double product = 1;
    for (size_t j = 0; j < nodes.size(); ++j) {
      if (j != i) product *= (nodes[i] - nodes[j]) * scale;
    }
    weights[i] = 1 / (product * (t - nodes[i]));
    sum += weights[i];
  }
  for (double& weight : weights) weight /= sum;
  return weights;
}

}  // namespace gld
