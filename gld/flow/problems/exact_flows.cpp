#include "gld/flow/problems/exact_flows.h"

#include "gld/base/error.h"
#include "gld/flow/solvers/solver.h"
#include "gld/tensors/weight_tensors.h"

#include <cmath>
#include <utility>

#include <ATen/CPUGeneratorImpl.h>

#include <fmt/format.h>

namespace gld {
namespace {

const auto kDouble = torch::TensorOptions().dtype(torch::kFloat64);

void require(bool good, const std::string& where, const std::string& expected, const std::string& found) {
  if (!good)
    fail({where, expected, found, "see the description of problem files in gld/flow/problems/exact_flows.h"});
}

torch::Tensor tensor_of_shape(const WeightFile& file, const std::string& name,
                              const std::vector<int64_t>& shape) {
  auto tensor = read_tensor(file, name);
  const std::string where = file.path().string() + ", tensor " + name;
  require(tensor.scalar_type() == torch::kFloat64, where, "float64 numbers", c10::str(tensor.scalar_type()));
  std::vector<int64_t> expected = shape;
  if (tensor.dim() == static_cast<int64_t>(shape.size())) {
    for (size_t i = 0; i < shape.size(); ++i) {
      if (shape[i] < 0) expected[i] = tensor.size(static_cast<int64_t>(i));
    }
  }
  require(tensor.sizes() == c10::IntArrayRef(expected) && tensor.numel() > 0, where,
          "a tensor of shape " + shape_text(expected) + " (-1: any size)", shape_text(tensor.sizes().vec()));
  require(torch::isfinite(tensor).all().item<bool>(), where, "finite numbers", "NaN or infinity");
  return tensor;
}

void require_positive(const torch::Tensor& tensor, const WeightFile& file, const std::string& name) {
  require(tensor.min().item<double>() > 0, file.path().string() + ", tensor " + name, "numbers above 0",
          fmt::format("{}", tensor.min().item<double>()));
}

}  // namespace

GaussianMixture GaussianMixture::subset(const std::vector<int64_t>& components) const {
  const auto index = torch::tensor(components, torch::kInt64);
  return {means.index_select(0, index), variances.index_select(0, index), weights.index_select(0, index)};
}

MixtureField::MixtureField(GaussianMixture mixture)
    : mixture_(std::move(mixture)), log_weights_(torch::log(mixture_.weights)) {}

torch::Tensor MixtureField::velocity(const torch::Tensor& state, double t) {
  const double a = 1 - t;
  const auto x = state.to(torch::kFloat64);
  const auto spread = a * a * mixture_.variances + t * t;   // (components, dimensions)
  const auto offset = x.unsqueeze(1) - a * mixture_.means;  // (samples, components, dimensions)
  const auto scaled = offset / spread;
  const auto log_posterior = log_weights_ - 0.5 * ((offset * scaled).sum(-1) + torch::log(spread).sum(-1));
  const auto posterior = torch::softmax(log_posterior, 1).unsqueeze(1);  // (samples, 1, components)
  // One sum over components of t s - mean - a variance s, where s is the scaled offset.
  const auto velocities = scaled * (t - a * mixture_.variances) - mixture_.means;
  return torch::matmul(posterior, velocities).squeeze(1).to(state.scalar_type());
}

MixtureBranches::MixtureBranches(const GaussianMixture& mixture,
                                 const std::vector<int64_t>& conditional_components)
    : all_(mixture), conditional_(mixture.subset(conditional_components)) {}

torch::Tensor MixtureBranches::conditional(const torch::Tensor& state, double t) {
  return conditional_.velocity(state, t);
}

torch::Tensor MixtureBranches::unconditional(const torch::Tensor& state, double t) {
  return all_.velocity(state, t);
}

FlowProblem read_flow_problem(const std::filesystem::path& path, const std::string& name) {
  const auto file = WeightFile::open(path);
  FlowProblem problem;
  problem.name = name;
  auto& mixture = problem.mixture;
  mixture.means = tensor_of_shape(*file, "means", {-1, -1});
  const int64_t components = mixture.means.size(0), dimensions = mixture.means.size(1);
  mixture.variances = tensor_of_shape(*file, "variances", {components, dimensions});
  mixture.weights = tensor_of_shape(*file, "weights", {components});
  require_positive(mixture.variances, *file, "variances");
  require_positive(mixture.weights, *file, "weights");
  problem.noise = tensor_of_shape(*file, "noise", {-1, dimensions});
  problem.solution = tensor_of_shape(*file, "solution", {problem.noise.size(0), dimensions});
  problem.standard_deviation = tensor_of_shape(*file, "standard_deviation", {dimensions});
  require_positive(problem.standard_deviation, *file, "standard_deviation");
  const auto scale = read_tensor(*file, "guidance_scale");
  require(scale.numel() == 1, path.string() + ", tensor guidance_scale", "one number",
          shape_text(scale.sizes().vec()));
  problem.guidance_scale = scale.to(torch::kFloat64).item<double>();
  const auto chosen = read_tensor(*file, "conditional_components").to(torch::kInt64).contiguous().flatten();
  for (int64_t i = 0; i < chosen.numel(); ++i) {
    const int64_t component = chosen[i].item<int64_t>();
    require(component >= 0 && component < components, path.string() + ", tensor conditional_components",
            fmt::format("components 0 to {}", components - 1), std::to_string(component));
    problem.conditional_components.push_back(component);
  }
  require(!problem.conditional_components.empty(), path.string() + ", tensor conditional_components",
          "at least one component", "none");
  return problem;
}

FlowProblem single_gaussian_problem(const SingleGaussianOptions& options) {
  constexpr double kMean = 0.5;
  auto generator = at::detail::createCPUGenerator(options.seed);
  FlowProblem problem;
  problem.name = fmt::format("gaussian_{:g}", options.width);
  problem.mixture = {torch::full({1, options.dimensions}, kMean, kDouble),
                     torch::full({1, options.dimensions}, options.width * options.width, kDouble),
                     torch::ones({1}, kDouble)};
  problem.conditional_components = {0};
  problem.noise = torch::randn({options.samples, options.dimensions}, generator, kDouble);
  problem.solution = kMean + options.width * problem.noise;
  problem.standard_deviation = torch::full({options.dimensions}, options.width, kDouble);
  return problem;
}

FlowProblem random_mixture_problem(const RandomMixtureOptions& options) {
  auto generator = at::detail::createCPUGenerator(options.seed);
  const int64_t n = options.dimensions, k = options.components;
  const auto scale =
      torch::logspace(std::log10(options.largest_scale), std::log10(options.smallest_scale), n, 10, kDouble);
  FlowProblem problem;
  problem.name = fmt::format("random_{}", options.seed);
  // The narrowest third of the dimensions has no separated means, as in latents whose small channels are noise.
  const auto separated = (torch::arange(n, kDouble) < 2.0 * static_cast<double>(n) / 3).to(torch::kFloat64);
  problem.mixture.means = 0.7 * scale * separated * torch::randn({k, n}, generator, kDouble);
  problem.mixture.variances =
      (0.7 * scale * torch::exp(0.3 * torch::randn({k, n}, generator, kDouble))).square();
  problem.mixture.weights = torch::ones({k}, kDouble);
  for (int64_t i = 0; i < options.conditional_components; ++i) problem.conditional_components.push_back(i);
  problem.guidance_scale = options.guidance_scale;
  problem.noise = torch::randn({options.samples, n}, generator, kDouble);
  const auto& mixture = problem.mixture;
  const auto mean = mixture.means.mean(0);
  problem.standard_deviation = (mixture.variances + (mixture.means - mean).square()).mean(0).sqrt();

  MixtureBranches branches(mixture, problem.conditional_components);
  GuidanceOptions guidance;
  guidance.guidance_scale = options.guidance_scale;
  GuidedField field(branches, guidance);
  SolverOptions solver;
  solver.solver = SolverKind::kDormandPrince;
  solver.tolerance = options.solution_tolerance;
  solver.max_evaluations = 1000000;
  problem.solution = solve_on(field, problem.noise, solver, {1, 0}, {problem.name, {}}).state;
  return problem;
}

FlowError flow_error(const FlowProblem& problem, const torch::Tensor& state) {
  const auto error = (state.to(torch::kFloat64) - problem.solution) / problem.standard_deviation;
  return {error.square().mean().sqrt().item<double>(), error.abs().max().item<double>()};
}

}  // namespace gld
