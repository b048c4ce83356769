#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

struct NamedParameter {
  std::string name;
  torch::Tensor parameter;  // shares its storage with the module
};

// Returns the parameters of a module that want a gradient, in registration order, named prefix + their name.
std::vector<NamedParameter> named_parameters(const torch::nn::Module& module, const std::string& prefix = "");

// Returns all else that a module's file holds, named likewise: the parameters that want none, and its buffers.
std::vector<NamedParameter> named_untrained(const torch::nn::Module& module, const std::string& prefix = "");

// The parameters of a training run laid out in one float32 buffer, and their gradients in another, so that
// clipping, the optimiser and the moving average are one pass over memory. The module's own tensors become
// views of these buffers. Every parameter starts at a multiple of 16 elements; the padding stays zero.
class FlatParameters {
 public:
  // Throws Error for a parameter that is not float32 or is on another device than the first.
  explicit FlatParameters(std::vector<NamedParameter> parameters);

  const std::vector<NamedParameter>& parameters() const { return parameters_; }
  const torch::Tensor& values() const { return values_; }        // (padded length)
  const torch::Tensor& gradients() const { return gradients_; }  // (padded length)

  // Returns where parameter `index` starts in the flat tensors.
  int64_t offset(size_t index) const { return offsets_[index]; }

  void zero_gradients();
  // Returns the part of a flat tensor that belongs to parameter `index`, in its shape.
  torch::Tensor part(const torch::Tensor& flat, size_t index) const;

 private:
  std::vector<NamedParameter> parameters_;
  std::vector<int64_t> offsets_;
  torch::Tensor values_;
  torch::Tensor gradients_;
};

}  // namespace gld
