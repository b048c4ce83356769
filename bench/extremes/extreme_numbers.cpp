// Attention, norms and flows at the ends of the range of numbers.
#include "bench/extremes/extreme_inputs.h"
#include "bench/extremes/extremes_benchmark.h"
#include "gld/attention/attention.h"
#include "gld/attention/composed_attention.h"
#include "gld/flow/flow.h"
#include "gld/flow/problems/exact_flows.h"
#include "gld/flow/solvers/solver.h"
#include "gld/tensors/fused_ops.h"

#include <cmath>
#include <limits>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/types.h>

#include <fmt/format.h>

namespace gld {
namespace {

// Half a unit in the last place of float32: a logit of size L is itself rounded by L times this.
constexpr double kRounding = 0x1p-24;

// The result is infinite when a value is not a number: std::max would drop it.
double largest(const torch::Tensor& x) {
  const double value = x.abs().max().item<double>();
  return std::isnan(value) ? std::numeric_limits<double>::infinity() : value;
}

AttentionInputs in_float32(AttentionInputs inputs) {
  inputs.query = inputs.query.to(torch::kFloat32);
  inputs.key = inputs.key.to(torch::kFloat32);
  inputs.value = inputs.value.to(torch::kFloat32);
  return inputs;
}

double attention_error(const AttentionInputs& inputs) {
  const auto single = in_float32(inputs);
  auto exact = single;
  exact.query = single.query.to(torch::kFloat64);
  exact.key = single.key.to(torch::kFloat64);
  exact.value = single.value.to(torch::kFloat64);
  const auto reference = composed_attention(exact);
  return largest(attention(single).to(torch::kFloat64) - reference) / largest(reference);
}

constexpr int64_t kNormChannels = 384;

// It takes rows of that magnitude, or of every magnitude from 1e-30 to 1e30 where it is 0, against double with every
// row scaled to magnitude 1 first: squares of less than 1e-300 would be none otherwise.
double rms_norm_error(double magnitude, double epsilon) {
  constexpr int64_t kRows = 61;
  auto x = extreme_random({kRows, kNormChannels}, 5);
  x = x * (magnitude > 0 ? torch::full({1, 1}, magnitude, torch::kFloat64)
                         : torch::pow(10.0, torch::arange(-30, 31, torch::kFloat64)).unsqueeze(1));
  RmsNormInputs inputs;
  inputs.x = x.to(torch::kFloat32);
  inputs.weight = torch::linspace(0.5, 1.5, kNormChannels);
  inputs.epsilon = epsilon;
  const auto y = rms_norm(inputs).to(torch::kFloat64);
  const auto wide = inputs.x.to(torch::kFloat64);
  const auto size = wide.abs().amax({-1}, true);
  const auto unit = wide / size;
  const auto exact = unit * torch::rsqrt(unit.square().mean(-1, true) + epsilon / size / size) *
                     inputs.weight.to(torch::kFloat64);
  return largest((y - exact) / exact.abs().amax({-1}, true));
}

FlowProblem extreme_mixture() {
  RandomMixtureOptions options;
  options.samples = 4;
  options.dimensions = 24;
  options.solution_tolerance = 1e-3;
  return random_mixture_problem(options);
}

double non_finite_values(const FlowProblem& problem, double guidance_scale, const SolverOptions& options) {
  MixtureBranches branches(problem.mixture, problem.conditional_components);
  GuidanceOptions guidance;
  guidance.guidance_scale = guidance_scale;
  GuidedField field(branches, guidance);
  const auto report = try_solve_on(field, problem.noise, options, solver_times(options));
  return report.failure ? static_cast<double>(problem.noise.numel()) : 0;
}

double non_finite_values_of(const FlowProblem& problem, SolverKind solver, ScheduleKind schedule) {
  double non_finite = 0;
  for (const double scale : {1.0, 7.0, 20.0}) {
    for (const double shift : {1.0, 100.0}) {
      for (const int64_t evaluations : {1, 2, 5, 40}) {
        SolverOptions options;
        options.solver = solver;
        options.evaluations = evaluations;
        options.schedule.schedule = schedule;
        options.schedule.shift = shift;
        non_finite += non_finite_values(problem, scale, options);
      }
    }
  }
  return non_finite;
}

}  // namespace

torch::Tensor extreme_random(c10::IntArrayRef sizes, uint64_t seed) {
  return torch::randn(sizes, at::detail::createCPUGenerator(seed), torch::kFloat64);
}

AttentionInputs attention_inputs_with_logits(double size, int64_t tokens) {
  constexpr int64_t kLogitHeadDim = 64;
  AttentionInputs inputs;
  const auto coarse = [](const torch::Tensor& x) { return torch::round(x * 8) / 8; };
  inputs.query = coarse(extreme_random({1, tokens, 2, kLogitHeadDim}, 1));
  inputs.key = coarse(extreme_random({1, tokens, 2, kLogitHeadDim}, 2));
  inputs.value = extreme_random({1, tokens, 2, kLogitHeadDim}, 3);
  const auto logits =
      torch::einsum("bqhc,bkhc->bhqk", {inputs.query, inputs.key}) / std::sqrt(double{kLogitHeadDim});
  const double factor =
      size > 0 ? std::exp2(std::floor(std::log2(size / logits.abs().max().item<double>()))) : 0;
  inputs.query = inputs.query * factor;
  return inputs;
}

std::vector<ExtremeRow> attention_extremes() {
  std::vector<ExtremeRow> rows;
  for (const double size : {0.0, 1.0, 1e2, 1e4}) {
    rows.push_back({"attention", size == 0 ? "all logits equal" : fmt::format("logits up to {:g}", size),
                    "relative error, fp32 against double",
                    attention_error(attention_inputs_with_logits(size, 96)), 2e-6 + size * kRounding});
  }
  rows.push_back({"attention", "one token", "relative error, fp32 against double",
                  attention_error(attention_inputs_with_logits(1, 1)), 2e-7});
  return rows;
}

std::vector<ExtremeRow> norm_extremes() {
  std::vector<ExtremeRow> rows;
  for (const double magnitude : {1e-30, 1e-20, 1e-10, 1e-3, 1.0, 1e10, 1e18, 1e20, 1e30}) {
    rows.push_back({"norms", fmt::format("RMS {:g}", magnitude), "relative error, fp32 against double",
                    rms_norm_error(magnitude, 1e-6), 1e-6});
  }
  for (const double epsilon : {1e-6, 1e-12, 0.0}) {
    rows.push_back({"norms", fmt::format("RMS 1e-30 to 1e30 side by side, epsilon {:g}", epsilon),
                    "relative error, fp32 against double", rms_norm_error(0, epsilon), 1e-6});
  }
  RmsNormInputs zero;
  zero.x = torch::zeros({2, 64});
  zero.epsilon = 1e-6;
  rows.push_back({"norms", "zero vector", "largest value", largest(rms_norm(zero)), 0});
  RmsNormInputs constant = zero;
  constant.x = torch::full({2, 64}, 56.0f);
  rows.push_back({"norms", "constant channels", "| value - 1 |", largest(rms_norm(constant) - 1), 1e-6});
  return rows;
}

std::vector<ExtremeRow> flow_extremes() {
  std::vector<ExtremeRow> rows;
  const auto data = extreme_random({64}, 7), noise = extreme_random({64}, 8);
  for (const double t : {0.0, 1e-12, 0.5, 1 - 1e-12, 1.0}) {
    const auto x = interpolate(data, noise, t), velocity = velocity_target(data, noise);
    const double error = std::max(largest(data_from_velocity(x, velocity, t) - data),
                                  largest(noise_from_velocity(x, velocity, t) - noise));
    rows.push_back(
        {"flow", fmt::format("t = {:.13g}", t), "error of data and noise from velocity", error, 1e-14});
    rows.push_back({"flow", fmt::format("t = {:.13g}", t), "error of t times the score",
                    largest(scaled_score_from_velocity(x, velocity, t) + noise), 1e-14});
  }
  const auto problem = extreme_mixture();
  for (const double scale : {1.0, 5.0, 20.0}) {
    SolverOptions options;
    rows.push_back({"flow", fmt::format("guidance scale {:g}", scale), "non-finite numbers",
                    non_finite_values(problem, scale, options), 0});
  }
  for (const SolverKind solver : {SolverKind::kEuler, SolverKind::kDpmSolver3M, SolverKind::kUniPc3}) {
    for (const ScheduleKind schedule :
         {ScheduleKind::kPublished, ScheduleKind::kShifted, ScheduleKind::kLogSnr}) {
      rows.push_back({"flow",
                      fmt::format("{} on {}, 1 to 40 evaluations, shifts 1 and 100, guidance 1 to 20",
                                  solver_names()[static_cast<size_t>(solver)],
                                  schedule_names()[static_cast<size_t>(schedule)]),
                      "non-finite numbers", non_finite_values_of(problem, solver, schedule), 0});
    }
  }
  for (const double shift : {1.0, 31.18, 100.0}) {
    SolverOptions options;
    options.solver = SolverKind::kEuler;
    options.evaluations = 49;
    options.schedule.schedule = ScheduleKind::kPublished;
    options.schedule.shift = shift;
    rows.push_back({"flow", fmt::format("published grid, shift {:g}", shift), "non-finite numbers",
                    non_finite_values(problem, 1.5, options), 0});
  }
  for (const int64_t evaluations : {1, 2, 3, 1000}) {
    SolverOptions options;
    options.evaluations = evaluations;
    rows.push_back({"flow", fmt::format("{} evaluations", evaluations), "non-finite numbers",
                    non_finite_values(problem, 1.5, options), 0});
  }
  return rows;
}

}  // namespace gld
