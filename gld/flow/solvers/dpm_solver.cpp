#include "gld/flow/data_prediction.h"
#include "gld/flow/solvers/data_history.h"
#include "gld/flow/solvers/solver_run.h"

namespace gld {

void run_dpm_solver(SolverRun& run, const std::vector<double>& times) {
  const SolverKind kind = run.options().solver;
  const size_t order = kind == SolverKind::kDpmSolver1 ? 1 : kind == SolverKind::kDpmSolver2M ? 2 : 3;
  DataHistory history;
  for (size_t i = 0; i + 1 < times.size(); ++i) {
    const double start = times[i], next = times[i + 1];
    const auto x = run.report().state;
    history.add(start, run.data(x, start), order);
    const auto& nodes = history.times();
    if (order == 3 && i == 0 && start < 1) {
      // A first-order start would cap the order at 2. From noise it is not needed: there the schedule takes the first
      // time towards 1 as steps are added.
      const auto predicted = history.combine(x, next / start, data_prediction_weights(start, next, nodes));
      DataHistory ends = history;
      ends.add(next, run.data(predicted, next), 2);
      run.accept(ends.combine(x, next / start, data_prediction_weights(start, next, ends.times())), next);
      continue;
    }
    const auto weights = kind == SolverKind::kDpmSolver2M && nodes.size() == 2
                             ? dpm_solver_2m_weights(start, next, nodes[1])
                             : data_prediction_weights(start, next, nodes);
    run.accept(history.combine(x, next / start, weights), next);
  }
}

}  // namespace gld
