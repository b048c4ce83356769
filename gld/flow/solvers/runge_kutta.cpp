#include "gld/flow/solvers/solver_run.h"

namespace gld {
namespace {

// Takes one step from time to next; h is negative because time runs down.
torch::Tensor runge_kutta_step(SolverRun& run, const torch::Tensor& x, double time, double next) {
  const double h = next - time, middle = time + h / 2;
  const auto k1 = run.velocity(x, time);
  switch (run.options().solver) {
    case SolverKind::kHeun: {
      const auto k2 = run.velocity(x + h * k1, next);
      return x + (h / 2) * (k1 + k2);
    }
    case SolverKind::kMidpoint:
      return x + h * run.velocity(x + (h / 2) * k1, middle);
    case SolverKind::kRungeKutta4: {
      const auto k2 = run.velocity(x + (h / 2) * k1, middle);
      const auto k3 = run.velocity(x + (h / 2) * k2, middle);
      const auto k4 = run.velocity(x + h * k3, next);
      return x + (h / 6) * (k1 + 2 * k2 + 2 * k3 + k4);
    }
    default:
      return x + h * k1;
  }
}

}  // namespace

void run_runge_kutta(SolverRun& run, const std::vector<double>& times) {
  for (size_t i = 0; i + 1 < times.size(); ++i) {
    run.accept(runge_kutta_step(run, run.report().state, times[i], times[i + 1]), times[i + 1]);
  }
}

}  // namespace gld
