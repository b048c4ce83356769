#pragma once

#include "gld/flow/solvers/solver.h"

#include <optional>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// Thrown inside a solve to leave it; solve() and try_solve_on() turn it into an Error or a report.
struct SolveStopped {
  std::optional<SolveFailure> failure;  // none where the observer wished it
};

// What every solver family works with: it counts evaluations and steps, stops at the first value that is not finite,
// tells the observer and stops where that says so.
class SolverRun {
 public:
  SolverRun(VelocityField& field, const SolverOptions& options, const SolveObserver& observer);

  // Returns the field's velocity, checked. Throws SolveStopped.
  torch::Tensor velocity(const torch::Tensor& state, double time);
  // Returns the data that it predicts.
  torch::Tensor data(const torch::Tensor& state, double time);

  void start(const torch::Tensor& state, double time, int64_t steps);
  // The step that ends here is kept. Throws SolveStopped when the state is not finite or the observer says stop.
  void accept(const torch::Tensor& state, double time);
  void reject() { ++report_.rejected; }
  [[noreturn]] void give_up(SolveFailureKind kind, const std::string& what, double time) const;

  const SolverOptions& options() const { return options_; }
  SolveReport& report() { return report_; }

 private:
  VelocityField& field_;
  const SolverOptions& options_;
  const SolveObserver& observer_;
  SolveReport report_;
  int64_t steps_ = 0;
  struct Evaluation {
    torch::Tensor state, velocity;
    double time = 1;
  };
  Evaluation last_;
};

bool all_finite(const torch::Tensor& tensor);

// The families. Each starts from report().state at times.front() and accepts steps until times.back().
void run_runge_kutta(SolverRun& run, const std::vector<double>& times);
void run_adams_bashforth(SolverRun& run, const std::vector<double>& times);
void run_dpm_solver(SolverRun& run, const std::vector<double>& times);
void run_unipc(SolverRun& run, const std::vector<double>& times);
void run_adaptive_runge_kutta(SolverRun& run, const std::vector<double>& times);
void run_rodas3(SolverRun& run, const std::vector<double>& times);
void run_stochastic(SolverRun& run, const std::vector<double>& times);

}  // namespace gld
