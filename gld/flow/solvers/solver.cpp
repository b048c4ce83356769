#include "gld/flow/solvers/solver.h"

#include "gld/base/error.h"
#include "gld/flow/solvers/solver_run.h"

#include <algorithm>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

enum class SolverClass { kFixedStep, kAdaptive, kStochastic };

struct SolverTraits {
  const char* name;
  SolverClass solver_class;
  int64_t stages;       // evaluations a step
  int64_t extra_start;  // evaluations beyond that, once
  void (*run)(SolverRun&, const std::vector<double>&);
};

// The rows are in the order of SolverKind.
const std::vector<SolverTraits>& solver_table() {
  static const std::vector<SolverTraits> table{
      {"euler", SolverClass::kFixedStep, 1, 0, run_runge_kutta},
      {"heun", SolverClass::kFixedStep, 2, 0, run_runge_kutta},
      {"midpoint", SolverClass::kFixedStep, 2, 0, run_runge_kutta},
      {"rk4", SolverClass::kFixedStep, 4, 0, run_runge_kutta},
      {"ab2", SolverClass::kFixedStep, 1, 0, run_adams_bashforth},
      {"ab3", SolverClass::kFixedStep, 1, 1, run_adams_bashforth},
      {"dpmpp1", SolverClass::kFixedStep, 1, 0, run_dpm_solver},
      {"dpmpp2m", SolverClass::kFixedStep, 1, 0, run_dpm_solver},
      {"dpmpp3m", SolverClass::kFixedStep, 1, 0, run_dpm_solver},
      {"unipc2", SolverClass::kFixedStep, 1, 0, run_unipc},
      {"unipc3", SolverClass::kFixedStep, 1, 0, run_unipc},
      {"bs32", SolverClass::kAdaptive, 3, 0, run_adaptive_runge_kutta},
      {"dp54", SolverClass::kAdaptive, 6, 0, run_adaptive_runge_kutta},
      {"rodas3", SolverClass::kAdaptive, 3, 0, run_rodas3},
      {"euler_maruyama", SolverClass::kStochastic, 1, 0, run_stochastic},
      {"stochastic_heun", SolverClass::kStochastic, 2, 0, run_stochastic},
  };
  return table;
}

const SolverTraits& traits(SolverKind solver) { return solver_table()[static_cast<size_t>(solver)]; }

}  // namespace

const std::vector<std::string>& solver_names() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> result;
    for (const SolverTraits& entry : solver_table()) result.emplace_back(entry.name);
    return result;
  }();
  return names;
}

void SolverOptions::visit(FieldVisitor& visitor) {
  visit_choice(visitor, {"solver", "how the flow is integrated"}, solver, solver_names());
  visitor.integer({"evaluations", "function evaluations of a fixed-step solver, per level"}, evaluations,
                  {1, 100000});
  schedule.visit(visitor);
  visitor.real({"tolerance", "local error of an adaptive solver, relative to 1 + |x|"}, tolerance,
               {1e-14, 1});
  visitor.integer({"max_evaluations", "where an adaptive solver gives up"}, max_evaluations, {1, 1000000000});
  visit_choice(visitor, {"diffusion", "how a stochastic solver's noise depends on flow time"}, diffusion,
               {"constant", "linear", "quadratic", "sine_squared"});
  visitor.real({"diffusion_strength", "factor of a stochastic solver's noise"}, diffusion_strength,
               {0, 1000});
  visitor.integer(
      {"noise_seed", "seed of a stochastic solver's noise, beside that of the noise it starts from"},
      noise_seed, {0});
}

void SolverOptions::check() const { schedule.check(); }

bool is_adaptive(SolverKind solver) { return traits(solver).solver_class == SolverClass::kAdaptive; }
bool is_stochastic(SolverKind solver) { return traits(solver).solver_class == SolverClass::kStochastic; }

int64_t steps_for_evaluations(SolverKind solver, int64_t evaluations) {
  const SolverTraits& entry = traits(solver);
  return std::max<int64_t>(1, (evaluations - entry.extra_start) / entry.stages);
}

std::vector<double> solver_times(const SolverOptions& options) {
  auto times = schedule_times(options.schedule, steps_for_evaluations(options.solver, options.evaluations));
  if (is_adaptive(options.solver)) times = {times.front(), times.back()};
  return times;
}

ErrorParts SolveFailure::parts(const std::string& stage) const {
  const std::string where = fmt::format("{}, step {}, flow time {:.6g}", stage, step, time);
  switch (kind) {
    case SolveFailureKind::kNonFinite:
      return {where, "finite numbers", "NaN or infinity in the " + what,
              "check the inputs of this stage, lower the guidance scale or take smaller steps"};
    case SolveFailureKind::kEvaluationLimit:
      return {where, "the solve to end within max_evaluations", "that more are needed",
              "raise max_evaluations or the tolerance, or use rodas3 for a small stiff problem"};
    case SolveFailureKind::kStepTooSmall:
      break;
  }
  return {where, "a step that changes the flow time", "that the tolerance asks for less than its rounding",
          "raise the tolerance or solve in double precision"};
}

SolveReport try_solve_on(VelocityField& field, const torch::Tensor& noise, const SolverOptions& options,
                         const std::vector<double>& times, const SolveObserver& observer) {
  check_times(times, observer.stage);
  SolverRun run(field, options, observer);
  const bool adaptive = is_adaptive(options.solver);
  try {
    run.start(noise, times.front(), adaptive ? 0 : static_cast<int64_t>(times.size()) - 1);
    traits(options.solver).run(run, times);
  } catch (const SolveStopped& stopped) {
    run.report().failure = stopped.failure;
    run.report().stopped = !stopped.failure;
  }
  return std::move(run.report());
}

SolveReport solve_on(VelocityField& field, const torch::Tensor& noise, const SolverOptions& options,
                     const std::vector<double>& times, const SolveObserver& observer) {
  auto report = try_solve_on(field, noise, options, times, observer);
  if (report.failure) throw Error(report.failure->parts(observer.stage));
  return report;
}

SolveReport solve(VelocityField& field, const torch::Tensor& noise, const SolverOptions& options,
                  const SolveObserver& observer) {
  return solve_on(field, noise, options, solver_times(options), observer);
}

}  // namespace gld
