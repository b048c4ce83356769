#include "train/optim/flat_parameters.h"

#include "gld/base/error.h"

#include <torch/autograd.h>

namespace gld {
namespace {

constexpr int64_t kAlignment = 16;  // floats: one cache line

int64_t padded(int64_t count) { return (count + kAlignment - 1) / kAlignment * kAlignment; }

}  // namespace

std::vector<NamedParameter> named_parameters(const torch::nn::Module& module, const std::string& prefix) {
  std::vector<NamedParameter> result;
  for (const auto& item : module.named_parameters(/*recurse=*/true)) {
    if (item.value().requires_grad()) result.push_back({prefix + item.key(), item.value()});
  }
  return result;
}

std::vector<NamedParameter> named_untrained(const torch::nn::Module& module, const std::string& prefix) {
  std::vector<NamedParameter> result;
  for (const auto& item : module.named_parameters(/*recurse=*/true)) {
    if (!item.value().requires_grad()) result.push_back({prefix + item.key(), item.value()});
  }
  for (const auto& item : module.named_buffers(/*recurse=*/true))
    result.push_back({prefix + item.key(), item.value()});
  return result;
}

FlatParameters::FlatParameters(std::vector<NamedParameter> parameters) : parameters_(std::move(parameters)) {
  if (parameters_.empty()) {
    fail({"training", "at least one parameter to train", "none", "check the objective's options"});
  }
  const torch::Device device = parameters_.front().parameter.device();
  int64_t length = 0;
  for (const auto& [name, parameter] : parameters_) {
    if (parameter.dtype() != torch::kFloat32 || parameter.device() != device) {
      fail({"parameter " + name, "float32 on " + device.str(),
            std::string(parameter.dtype().name()) + " on " + parameter.device().str(),
            "train in float32; reduced precision comes from autocast"});
    }
    offsets_.push_back(length);
    length += padded(parameter.numel());
  }
  const torch::NoGradGuard no_grad;
  values_ = torch::zeros({length}, torch::TensorOptions().device(device).dtype(torch::kFloat32));
  gradients_ = torch::zeros_like(values_);
  for (size_t i = 0; i < parameters_.size(); ++i) {
    torch::Tensor& parameter = parameters_[i].parameter;
    const torch::Tensor view = part(values_, i);
    view.copy_(parameter);
    parameter.set_data(view);
    parameter.set_requires_grad(true);
    // Autograd adds in place to a gradient that exists, so these views are kept for the whole run.
    parameter.mutable_grad() = part(gradients_, i);
  }
}

void FlatParameters::zero_gradients() { gradients_.zero_(); }

torch::Tensor FlatParameters::part(const torch::Tensor& flat, size_t index) const {
  const torch::Tensor& parameter = parameters_[index].parameter;
  return flat.narrow(0, offsets_[index], parameter.numel()).view(parameter.sizes());
}

}  // namespace gld
