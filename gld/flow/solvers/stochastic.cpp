#include "gld/base/philox.h"
#include "gld/flow/flow.h"
#include "gld/flow/solvers/solver_run.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

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

// A row is a view in sampling. Its noise in each step follows from the seed and from what the row begins with, which is
// noise of its own for each sample, level and view (gld/latents/noise.h): so it is another one for each of them too,
// and the same whatever rows are beside it.
class RowNoise {
 public:
  RowNoise(const torch::Tensor& begin, int64_t seed) : seed_(static_cast<uint64_t>(seed)) {
    const auto rows = begin.detach().to(torch::kCPU).contiguous();
    const int64_t count = rows.dim() == 0 ? 1 : rows.size(0);
    const auto bytes = static_cast<size_t>(rows.numel() / std::max<int64_t>(count, 1) * rows.element_size());
    const auto* data = static_cast<const char*>(rows.data_ptr());
    for (int64_t row = 0; row < count; ++row)
      rows_.push_back(fnv1a(std::string(data + static_cast<size_t>(row) * bytes, bytes)));
  }

  // Returns standard normal numbers of that shape, whose first dimension counts the rows.
  torch::Tensor of_step(size_t step, const torch::Tensor& like) const {
    auto noise = torch::empty(like.sizes(), torch::kFloat32);
    const int64_t per_row = noise.numel() / std::max<int64_t>(static_cast<int64_t>(rows_.size()), 1);
    NormalRun run;
    run.key = philox_key(seed_, "diffusion, step " + std::to_string(step));
    for (size_t row = 0; row < rows_.size(); ++row) {
      run.index = rows_[row];
      fill_normal(run, noise.data_ptr<float>() + static_cast<int64_t>(row) * per_row, per_row);
    }
    return noise.to(like.device(), like.scalar_type());
  }

 private:
  uint64_t seed_;
  std::vector<uint64_t> rows_;  // hashes
};

}  // namespace

void run_stochastic(SolverRun& run, const std::vector<double>& times) {
  const RowNoise row_noise(run.report().state, run.options().noise_seed);
  for (size_t i = 0; i + 1 < times.size(); ++i) {
    const double t = times[i], next = times[i + 1], h = t - next;
    const auto x = run.report().state;
    // Noise added at t = 0 would stay in the data, so the step that ends there follows the flow alone.
    if (next == 0) {
      run.accept(x - h * run.velocity(x, t), next);
      continue;
    }
    const auto noise = row_noise.of_step(i, x);
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
