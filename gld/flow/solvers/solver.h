#pragma once

#include "gld/base/error.h"
#include "gld/base/options.h"
#include "gld/flow/schedule.h"
#include "gld/flow/velocity_field.h"

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// Solvers of dx/dt = velocity(x, t) from noise (t = 1) to data (t = 0). Order of convergence in brackets.
//
// - Runge-Kutta on the schedule's times: euler [1], heun [2], midpoint [2], rk4 [4], with 1, 2, 2, 4
//   evaluations a step.
// - Adams-Bashforth for unequal steps: ab2 [2], ab3 [3]. ab3 spends one evaluation more on a start that keeps
//   its order.
// - DPM-Solver++ (Lu et al. 2022), multistep, data prediction: dpmpp1 [1], dpmpp2m [2], dpmpp3m [3]. dpmpp3m
//   spends one evaluation more on its start where that is not t = 1.
// - UniPC (Zhao et al. 2023): unipc2 [3], unipc3 [3]. A predictor of order 2 or 3, and a corrector that costs
//   no evaluation and raises the order by one; the first step caps unipc3 at 3.
// - Adaptive: bs32, Bogacki-Shampine 3(2), and dp54, Dormand-Prince 5(4).
// - For small stiff problems: rodas3 [3], an adaptive L-stable Rosenbrock method with a dense Jacobian.
// - The reverse stochastic equation with the same marginals: euler_maruyama, stochastic_heun.
enum class SolverKind {
  kEuler,
  kHeun,
  kMidpoint,
  kRungeKutta4,
  kAdamsBashforth2,
  kAdamsBashforth3,
  kDpmSolver1,
  kDpmSolver2M,
  kDpmSolver3M,
  kUniPc2,
  kUniPc3,
  kBogackiShampine,
  kDormandPrince,
  kRodas3,
  kEulerMaruyama,
  kStochasticHeun,
};

const std::vector<std::string>& solver_names();

// w(t) of the stochastic equation dx = (velocity - w/2 score) dt + sqrt(w) dW (t running down): strength
// times 1, t, t^2, or sin^2(pi t) (Ma et al. 2024 (SiT), table 2).
enum class DiffusionForm { kConstant, kLinear, kQuadratic, kSineSquared };

struct SolverOptions : OptionsGroup {
  SolverKind solver = SolverKind::kUniPc3;
  // Function evaluations of a fixed-step solver; the schedule gets as many steps as they pay for. The
  // published sampler's 50 times are 49 evaluations.
  int64_t evaluations = 16;
  ScheduleOptions schedule;
  // Adaptive solvers have a local error per step relative to 1 + |x|, and a number of evaluations at which they give
  // up.
  double tolerance = 1e-4;
  int64_t max_evaluations = 10000;
  // Stochastic solvers.
  DiffusionForm diffusion = DiffusionForm::kLinear;
  double diffusion_strength = 1;
  int64_t noise_seed = 0;

  // The fields are solver, evaluations, those of schedule (not nested), tolerance, max_evaluations, diffusion,
  // diffusion_strength, noise_seed.
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

bool is_adaptive(SolverKind solver);
bool is_stochastic(SolverKind solver);

// Returns how many steps of the schedule this many evaluations pay for, at least 1.
int64_t steps_for_evaluations(SolverKind solver, int64_t evaluations);

// Returns the times that a solve with these options visits; for adaptive solvers only the first and the last.
std::vector<double> solver_times(const SolverOptions& options);

struct SolveProgress {
  int64_t step = 0;         // accepted steps so far
  int64_t steps = 0;        // of how many; 0 where an adaptive solver cannot know
  double time = 1;          // flow time reached
  int64_t evaluations = 0;  // so far
  // The data that the last evaluation predicts; empty before the first.
  std::function<torch::Tensor()> predicted_data;
};

enum class SolveDecision { kGoOn, kStop };

struct SolveObserver {
  std::string stage = "solver";  // named in errors, e.g. "level 1"
  // After each accepted step; may be empty. What it means that a solve was stopped, whoever calls it decides.
  std::function<SolveDecision(const SolveProgress&)> on_step;
  // Before each evaluation, of which a step may have several and a rejected one is no step; may be empty.
  std::function<SolveDecision()> before_evaluation = nullptr;
};

enum class SolveFailureKind { kNonFinite, kEvaluationLimit, kStepTooSmall };

// Why a solve stopped before its last time.
struct SolveFailure {
  SolveFailureKind kind = SolveFailureKind::kNonFinite;
  std::string what;                                  // "velocity", "state", ...: where it first appeared
  int64_t step = 0;                                  // the step being taken, from 1
  double time = 0;                                   // the flow time of that value
  ErrorParts parts(const std::string& stage) const;  // the sentence for the user
};

struct SolveReport {
  torch::Tensor state;                  // at times.back(); shape and dtype of the noise
  int64_t evaluations = 0;              // calls of the field
  int64_t accepted = 0;                 // steps
  int64_t rejected = 0;                 // steps that an adaptive solver repeated
  std::vector<double> times;            // start and end of every accepted step, in order
  bool stopped = false;                 // by the observer: the state is that of the last accepted step
  std::optional<SolveFailure> failure;  // only from try_solve_on
};

// Solves from the schedule's first time, where the state is noise, to its last, or until the observer stops it. Throws
// Error, with stage, step and time, as soon as a value is not finite or an adaptive solver gives up. It is
// deterministic for a given field.
SolveReport solve(VelocityField& field, const torch::Tensor& noise, const SolverOptions& options,
                  const SolveObserver& observer = {});

// Does the same on given times (strictly decreasing within [0, 1]) instead of the schedule; for adaptive solvers only
// the first and last count.
SolveReport solve_on(VelocityField& field, const torch::Tensor& noise, const SolverOptions& options,
                     const std::vector<double>& times, const SolveObserver& observer = {});

// Solves as solve_on does, but a solve that stops early is reported in failure, with the state of the last accepted
// step.
SolveReport try_solve_on(VelocityField& field, const torch::Tensor& noise, const SolverOptions& options,
                         const std::vector<double>& times, const SolveObserver& observer = {});

}  // namespace gld
