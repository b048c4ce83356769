#include "models/layers/initialisation.h"

#include <cmath>
#include <map>
#include <string>

#include <torch/autograd.h>

namespace gld {
namespace {

struct Fans {
  double in = 1;
  double out = 1;
};

Fans fans_of(const torch::Tensor& weight) {
  const double kernel = static_cast<double>(weight[0][0].numel());
  return {static_cast<double>(weight.size(1)) * kernel, static_cast<double>(weight.size(0)) * kernel};
}

torch::Tensor uniform_like(const torch::Tensor& tensor, double bound, const torch::Generator& generator) {
  return torch::empty(tensor.sizes(), torch::kFloat32).uniform_(-bound, bound, generator);
}

bool is_gain(const std::string& name) {
  const auto last = name.substr(name.rfind('.') + 1);
  return last == "weight" || last == "gamma";
}

}  // namespace

void fill_truncated_normal(torch::Tensor& tensor, double deviation, const torch::Generator& generator) {
  torch::NoGradGuard no_grad;
  // Inverse of the normal distribution function between -2 and 2 deviations.
  const double lowest = std::erf(-2 / std::sqrt(2.0));
  const auto uniform = torch::empty(tensor.sizes(), torch::kFloat64).uniform_(lowest, -lowest, generator);
  tensor.copy_(torch::erfinv(uniform) * (std::sqrt(2.0) * deviation));
}

void initialise_parameters(torch::nn::Module& module, MatrixInitialisation matrices,
                           const torch::Generator& generator) {
  torch::NoGradGuard no_grad;
  std::map<std::string, torch::Tensor> parameters;
  for (const auto& item : module.named_parameters()) parameters[item.key()] = item.value();
  for (auto& [name, parameter] : parameters) {
    if (parameter.dim() < 2) {
      parameter.fill_(is_gain(name) ? 1 : 0);
    } else if (matrices == MatrixInitialisation::kTruncatedNormal) {
      fill_truncated_normal(parameter, 0.02, generator);
    } else {
      const auto fans = fans_of(parameter);
      const double bound = matrices == MatrixInitialisation::kXavierUniform
                               ? std::sqrt(6 / (fans.in + fans.out))
                               : 1 / std::sqrt(fans.in);
      parameter.copy_(uniform_like(parameter, bound, generator));
    }
  }
}

}  // namespace gld
