#include "gld/flow/data_prediction.h"
#include "gld/flow/solvers/data_history.h"
#include "gld/flow/solvers/solver_run.h"

namespace gld {

void run_unipc(SolverRun& run, const std::vector<double>& times) {
  const size_t order = run.options().solver == SolverKind::kUniPc2 ? 2 : 3;
  DataHistory history;
  torch::Tensor corrected = run.report().state;  // at times[i - 1] when step i begins
  for (size_t i = 0; i + 1 < times.size(); ++i) {
    const double start = times[i], next = times[i + 1];
    history.add(start, run.data(run.report().state, start), order + 1);
    if (i == 0) {
      corrected = run.report().state;
    } else {
      // The evaluation at the predicted state serves twice: it corrects the step that led here, and it starts the next.
      const double before = times[i - 1];
      corrected =
          history.combine(corrected, start / before, data_prediction_weights(before, start, history.times()));
    }
    const auto weights = data_prediction_weights(start, next, history.newest_times(order));
    run.accept(history.combine(corrected, next / start, weights), next);
  }
}

}  // namespace gld
