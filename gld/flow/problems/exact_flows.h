#pragma once

#include "gld/flow/guidance.h"
#include "gld/flow/velocity_field.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// A mixture of axis-aligned Gaussians as data distribution. Everything in double.
struct GaussianMixture {
  torch::Tensor means;      // (components, dimensions)
  torch::Tensor variances;  // (components, dimensions), positive
  torch::Tensor weights;    // (components), positive; need not sum to 1

  GaussianMixture subset(const std::vector<int64_t>& components) const;
};

// The exact velocity E[noise | x] - E[data | x] of a mixture for t in [0, 1], both ends included. With a = 1 - t and
// V = a^2 variance + t^2 a component gives E[noise | x] = t (x - a mean)/V and E[data | x] = mean + a variance (x - a
// mean)/V, weighted by its posterior probability.
// state and result: (samples, dimensions), any floating dtype; computed in double.
class MixtureField : public VelocityField {
 public:
  explicit MixtureField(GaussianMixture mixture);
  torch::Tensor velocity(const torch::Tensor& state, double t) override;

 private:
  GaussianMixture mixture_;
  torch::Tensor log_weights_;
};

// The conditional branch sees some of the components, the unconditional one all.
class MixtureBranches : public BranchedField {
 public:
  MixtureBranches(const GaussianMixture& mixture, const std::vector<int64_t>& conditional_components);
  torch::Tensor conditional(const torch::Tensor& state, double t) override;
  torch::Tensor unconditional(const torch::Tensor& state, double t) override;

 private:
  MixtureField all_;
  MixtureField conditional_;
};

// A flow with a known solution: noise at t = 1, solution at t = 0, and the spread that errors are measured by.
struct FlowProblem {
  std::string name;
  GaussianMixture mixture;
  std::vector<int64_t> conditional_components;
  double guidance_scale = 1;
  torch::Tensor noise;               // (samples, dimensions)
  torch::Tensor solution;            // (samples, dimensions)
  torch::Tensor standard_deviation;  // (dimensions)
};

// Reads a problem file: safetensors in double with means, variances, weights, conditional_components,
// guidance_scale, noise, solution and standard_deviation. Throws Error naming the tensor that does not fit.
FlowProblem read_flow_problem(const std::filesystem::path& file, const std::string& name);

// One Gaussian of that width around 0.5 in every dimension, whose flow ends at 0.5 + width noise.
struct SingleGaussianOptions {
  double width = 1;
  int64_t samples = 64;
  int64_t dimensions = 4;
  uint64_t seed = 0;
};
FlowProblem single_gaussian_problem(const SingleGaussianOptions& options);

// A random mixture whose dimensions have scales from largest_scale to smallest_scale; the solution comes from
// Dormand-Prince at 1e-9.
struct RandomMixtureOptions {
  int64_t dimensions = 32;
  int64_t components = 6;
  int64_t conditional_components = 2;
  int64_t samples = 48;
  double largest_scale = 60;
  double smallest_scale = 0.05;
  double guidance_scale = 1.5;
  double solution_tolerance = 1e-9;
  uint64_t seed = 0;
};
FlowProblem random_mixture_problem(const RandomMixtureOptions& options);

struct FlowError {
  double rms = 0;      // over samples and dimensions, of (state - solution)/standard_deviation
  double largest = 0;  // its largest absolute value
};
FlowError flow_error(const FlowProblem& problem, const torch::Tensor& state);

}  // namespace gld
