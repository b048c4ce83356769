#include "gld/flow/solvers/solver_run.h"

#include <algorithm>
#include <cmath>

namespace gld {
namespace {

// An explicit pair whose last stage is the first of the next step (FSAL).
struct EmbeddedPair {
  int order;                           // of the solution that is kept
  std::vector<double> nodes;           // c
  std::vector<std::vector<double>> a;  // the last row holds the weights of the solution
  std::vector<double> error;           // weights of solution minus embedded solution
};

// Bogacki and Shampine 1989.
const EmbeddedPair& bogacki_shampine() {
  static const EmbeddedPair pair{3,
                                 {0, 1.0 / 2, 3.0 / 4, 1},
                                 {{}, {1.0 / 2}, {0, 3.0 / 4}, {2.0 / 9, 1.0 / 3, 4.0 / 9}},
                                 {-5.0 / 72, 1.0 / 12, 1.0 / 9, -1.0 / 8}};
  return pair;
}

// Dormand and Prince 1980.
const EmbeddedPair& dormand_prince() {
  static const EmbeddedPair pair{
      5,
      {0, 1.0 / 5, 3.0 / 10, 4.0 / 5, 8.0 / 9, 1, 1},
      {{},
       {1.0 / 5},
       {3.0 / 40, 9.0 / 40},
       {44.0 / 45, -56.0 / 15, 32.0 / 9},
       {19372.0 / 6561, -25360.0 / 2187, 64448.0 / 6561, -212.0 / 729},
       {9017.0 / 3168, -355.0 / 33, 46732.0 / 5247, 49.0 / 176, -5103.0 / 18656},
       {35.0 / 384, 0, 500.0 / 1113, 125.0 / 192, -2187.0 / 6784, 11.0 / 84}},
      {71.0 / 57600, 0, -71.0 / 16695, 71.0 / 1920, -17253.0 / 339200, 22.0 / 525, -1.0 / 40}};
  return pair;
}

// Returns the RMS of values / (tolerance (1 + scale)), in double.
double weighted_norm(const torch::Tensor& values, const torch::Tensor& scale, double tolerance) {
  return (values / (scale + 1)).to(torch::kFloat64).square().mean().sqrt().item<double>() / tolerance;
}

// Follows Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, section II.4. It takes one evaluation.
double first_step_size(SolverRun& run, const torch::Tensor& slope, double length, int order) {
  const auto& x = run.report().state;
  const double time = run.report().times.front();
  const auto scale = x.abs();
  const double size = weighted_norm(x, scale, 1), speed = weighted_norm(slope, scale, 1);
  const double trial = std::min(size < 1e-5 || speed < 1e-5 ? 1e-6 : 0.01 * size / speed, length);
  const auto bend = run.velocity(x - trial * slope, time - trial) - slope;
  const double curvature = weighted_norm(bend, scale, 1) / trial;
  const double largest = std::max(speed, curvature) / run.options().tolerance;
  const double step = largest <= 1e-15 ? std::max(1e-6, trial * 1e-3) : std::pow(0.01 / largest, 1.0 / order);
  return std::min({100 * trial, step, length});
}

struct Trial {
  torch::Tensor state;
  torch::Tensor last_slope;
  double error = 0;  // below 1 where the step is good enough
};

Trial try_step(SolverRun& run, const EmbeddedPair& pair, const torch::Tensor& first_slope, double time,
               double h) {
  const auto x = run.report().state;
  std::vector<torch::Tensor> slopes{first_slope};
  torch::Tensor state;
  for (size_t stage = 1; stage < pair.nodes.size(); ++stage) {
    state = x.clone();
    for (size_t j = 0; j < stage; ++j) {
      if (pair.a[stage][j] != 0) state.add_(slopes[j], -h * pair.a[stage][j]);
    }
    slopes.push_back(
        run.velocity(state, pair.nodes[stage] == 1 ? std::max(time - h, 0.0) : time - pair.nodes[stage] * h));
  }
  auto error = torch::zeros_like(x);
  for (size_t j = 0; j < slopes.size(); ++j) {
    if (pair.error[j] != 0) error.add_(slopes[j], h * pair.error[j]);
  }
  return {state, slopes.back(),
          weighted_norm(error, torch::maximum(x.abs(), state.abs()), run.options().tolerance)};
}

}  // namespace

void run_adaptive_runge_kutta(SolverRun& run, const std::vector<double>& times) {
  const EmbeddedPair& pair =
      run.options().solver == SolverKind::kBogackiShampine ? bogacki_shampine() : dormand_prince();
  // PI control (Gustafsson 1991; Hairer and Wanner II, section IV.2).
  const double integral = 0.7 / pair.order, proportional = 0.4 / pair.order;
  constexpr double kSafety = 0.9, kSmallest = 0.2, kLargest = 5;
  constexpr int kMostFailures = 8;

  const double last = times.back();
  double time = times.front(), previous_error = 1;
  auto slope = run.velocity(run.report().state, time);
  double h = first_step_size(run, slope, time - last, pair.order);
  bool after_rejection = false;
  int failures = 0;
  while (time > last) {
    const bool final_step = h >= (time - last) * (1 - 1e-12);
    if (final_step) h = time - last;
    if (!(time - h < time)) run.give_up(SolveFailureKind::kStepTooSmall, "step", time);
    Trial trial;
    try {
      trial = try_step(run, pair, slope, time, h);
    } catch (const SolveStopped& stopped) {
      // Too long a step may leave the region where the field is finite; a shorter one need not.
      const bool non_finite = stopped.failure && stopped.failure->kind == SolveFailureKind::kNonFinite;
      if (!non_finite || ++failures == kMostFailures) throw;
      trial.error = 1e10;
    }
    if (!(trial.error <= 1)) {
      run.reject();
      h *= std::isfinite(trial.error)
               ? std::max(kSmallest, kSafety * std::pow(trial.error, -1.0 / pair.order))
               : kSmallest;
      after_rejection = true;
      continue;
    }
    time = final_step ? last : time - h;
    run.accept(trial.state, time);
    slope = trial.last_slope;
    const double error = std::max(trial.error, 1e-10);
    double factor = kSafety * std::pow(error, -integral) * std::pow(previous_error, proportional);
    factor = std::clamp(factor, kSmallest, after_rejection ? 1.0 : kLargest);
    previous_error = std::max(error, 1e-4);
    h *= factor;
    after_rejection = false;
    failures = 0;
  }
}

}  // namespace gld
