#include "gld/flow/solvers/solver_run.h"

#include "gld/flow/flow.h"

#include <cmath>

namespace gld {

SolverRun::SolverRun(VelocityField& field, const SolverOptions& options, const SolveObserver& observer)
    : field_(field), options_(options), observer_(observer) {}

torch::Tensor SolverRun::velocity(const torch::Tensor& state, double time) {
  if ((is_adaptive(options_.solver)) && report_.evaluations >= options_.max_evaluations) {
    give_up(SolveFailureKind::kEvaluationLimit, "evaluations", time);
  }
  if (observer_.before_evaluation && observer_.before_evaluation() == SolveDecision::kStop)
    throw SolveStopped{};
  auto result = field_.velocity(state, time);
  ++report_.evaluations;
  if (!all_finite(result)) give_up(SolveFailureKind::kNonFinite, "velocity", time);
  if (observer_.on_step) last_ = {state, result, time};
  return result;
}

torch::Tensor SolverRun::data(const torch::Tensor& state, double time) {
  return data_from_velocity(state, velocity(state, time), time);
}

void SolverRun::start(const torch::Tensor& state, double time, int64_t steps) {
  report_.state = state;
  report_.times = {time};
  steps_ = steps;
  if (!all_finite(state)) give_up(SolveFailureKind::kNonFinite, "noise", time);
}

void SolverRun::accept(const torch::Tensor& state, double time) {
  if (!all_finite(state)) give_up(SolveFailureKind::kNonFinite, "state", time);
  report_.state = state;
  report_.times.push_back(time);
  ++report_.accepted;
  if (!observer_.on_step) return;
  const auto predicted = [this] { return data_from_velocity(last_.state, last_.velocity, last_.time); };
  const auto decision = observer_.on_step({report_.accepted, steps_, time, report_.evaluations, predicted});
  if (decision == SolveDecision::kStop) throw SolveStopped{};
}

void SolverRun::give_up(SolveFailureKind kind, const std::string& what, double time) const {
  throw SolveStopped{SolveFailure{kind, what, report_.accepted + 1, time}};
}

bool all_finite(const torch::Tensor& tensor) {
  // One pass without a temporary; only an overflowing sum of finite values needs the second look.
  if (std::isfinite(tensor.sum().item<double>())) return true;
  return torch::isfinite(tensor).all().item<bool>();
}

}  // namespace gld
