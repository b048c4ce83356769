#include "gld/flow/solvers/solver_run.h"

#include <algorithm>
#include <array>

namespace gld {
namespace {

// Returns the weights b_j of the velocities at nodes[0] (the step's start), nodes[1], ... so that x + sum_j b_j v_j is
// exact for a velocity that is a polynomial in t. They are the integrals of Lagrange's polynomials on unequal nodes.
std::vector<double> adams_bashforth_weights(const std::vector<double>& nodes, double next) {
  const double h = next - nodes[0];
  if (nodes.size() == 1) return {h};
  const double p = nodes[1] - nodes[0];  // positive: earlier nodes have larger times
  if (nodes.size() == 2) return {h - h * h / (2 * p), h * h / (2 * p)};
  const double q = nodes[2] - nodes[0];
  const double first = h * h / 2, second = h * h * h / 3;  // integrals of (t - t0) and (t - t0)^2
  return {h + (second - (p + q) * first) / (p * q), (second - q * first) / (p * (p - q)),
          (second - p * first) / (q * (q - p))};
}

}  // namespace

void run_adams_bashforth(SolverRun& run, const std::vector<double>& times) {
  const bool third_order = run.options().solver == SolverKind::kAdamsBashforth3;
  const size_t history = third_order ? 3 : 2;
  std::vector<double> nodes;
  std::vector<torch::Tensor> velocities;
  for (size_t i = 0; i + 1 < times.size(); ++i) {
    const auto x = run.report().state;
    const double h = times[i + 1] - times[i];
    nodes.insert(nodes.begin(), times[i]);
    velocities.insert(velocities.begin(), run.velocity(x, times[i]));
    if (nodes.size() > history) {
      nodes.pop_back();
      velocities.pop_back();
    }
    torch::Tensor next;
    // A first Euler step has a local error of order h^2, which would cap ab3 at order 2: take Heun's there. (Where the
    // budget is a single evaluation it stays Euler's.)
    if (third_order && i == 0 && run.options().evaluations > 1) {
      next = x + (h / 2) * (velocities[0] + run.velocity(x + h * velocities[0], times[1]));
    } else {
      const auto weights = adams_bashforth_weights(nodes, times[i + 1]);
      next = x.clone();
      for (size_t j = 0; j < weights.size(); ++j) next.add_(velocities[j], weights[j]);
    }
    run.accept(next, times[i + 1]);
  }
}

}  // namespace gld
