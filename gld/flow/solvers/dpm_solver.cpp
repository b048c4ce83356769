#include "gld/flow/data_prediction.h"
#include "gld/flow/solvers/solver_run.h"

#include <algorithm>

namespace gld {
namespace {

// The newest data predictions first.
class DataHistory {
 public:
  void add(double time, const torch::Tensor& data, size_t limit) {
    times_.insert(times_.begin(), time);
    values_.insert(values_.begin(), data);
    times_.resize(std::min(times_.size(), limit));
    values_.resize(times_.size());
  }
  const std::vector<double>& times() const { return times_; }
  std::vector<double> newest_times(size_t count) const {
    return {times_.begin(), times_.begin() + static_cast<std::ptrdiff_t>(std::min(count, times_.size()))};
  }
  // (next/start) x + sum_j weights_j D_j
  torch::Tensor combine(const torch::Tensor& x, double ratio, const std::vector<double>& weights) const {
    auto result = x * ratio;
    for (size_t j = 0; j < weights.size(); ++j) {
      if (weights[j] != 0) result.add_(values_[j], weights[j]);
    }
    return result;
  }

 private:
  std::vector<double> times_;
  std::vector<torch::Tensor> values_;
};

}  // namespace

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
