#include "gld/flow/flow.h"
#include "gld/flow/solvers/solver_run.h"

#include <cmath>

#include <ATen/CPUGeneratorImpl.h>

namespace gld {
namespace {

// w(t), and w(t)/t, which the drift needs: the score is -E[noise | x]/t.
struct Diffusion {
  double squared = 0;
  double squared_over_time = 0;
};

Diffusion diffusion_at(const SolverOptions& options, double t) {
  const double strength = options.diffusion_strength;
  switch (options.diffusion) {
    case DiffusionForm::kConstant:
      return {strength, strength / t};
    case DiffusionForm::kLinear:
      return {strength * t, strength};
    case DiffusionForm::kQuadratic:
      return {strength * t * t, strength * t};
    case DiffusionForm::kSineSquared:
      break;
  }
  const double sine = std::sin(M_PI * t);
  return {strength * sine * sine, strength * sine * sine / t};
}

// Returns velocity - w/2 score, where the score is -E[noise | x]/t and the expectation is what the velocity predicts.
torch::Tensor drift(SolverRun& run, const torch::Tensor& x, double t) {
  const auto velocity = run.velocity(x, t);
  return velocity +
         (diffusion_at(run.options(), t).squared_over_time / 2) * noise_from_velocity(x, velocity, t);
}

}  // namespace

void run_stochastic(SolverRun& run, const std::vector<double>& times) {
  auto generator = at::detail::createCPUGenerator(static_cast<uint64_t>(run.options().noise_seed));
  for (size_t i = 0; i + 1 < times.size(); ++i) {
    const double t = times[i], next = times[i + 1], h = t - next;
    const auto x = run.report().state;
    // Noise added at t = 0 would stay in the data, so the step that ends there follows the flow alone.
    if (next == 0) {
      run.accept(x - h * run.velocity(x, t), next);
      continue;
    }
    const auto noise = torch::randn(x.sizes(), generator, torch::dtype(x.scalar_type())).to(x.device());
    const double spread = std::sqrt(h * diffusion_at(run.options(), t).squared);
    if (run.options().solver == SolverKind::kEulerMaruyama) {
      run.accept(x - h * drift(run, x, t) + spread * noise, next);
      continue;
    }
    // Heun as in SiT's samplers: the step's noise first, then the trapezoidal rule on the drift.
    const auto noisy = x + spread * noise;
    const auto first = drift(run, noisy, t);
    const auto second = drift(run, noisy - h * first, next);
    run.accept(noisy - (h / 2) * (first + second), next);
  }
}

}  // namespace gld
