#pragma once

#include "gld/tensors/packed_layer.h"
#include "models/layers/layer_precision.h"

#include <memory>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// Where and how parameters are allocated. On the meta device only names and shapes exist. Parameters are
// UNINITIALISED after construction: load weights strictly (models/weights/weight_loading.h) or call an initialise
// function.
struct ParameterPlacement {
  torch::Device device = torch::kCPU;
  torch::Dtype dtype = torch::kFloat32;

  torch::TensorOptions options() const { return torch::TensorOptions().device(device).dtype(dtype); }
};

// Whether a linear layer's weights are packed when its model is given a precision. Layers whose weights others read,
// and those that stay float32 (models/layers/layer_precision.h), never are.
enum class LinearPacking { kOnce, kNever };

struct LinearSizes {
  int64_t inputs = 0;
  int64_t outputs = 0;
  bool bias = true;
  int64_t parts = 1;  // equal shares of the outputs that forward_parts gives apart
  LinearPacking packing = LinearPacking::kOnce;
};

// Computes y = x W^T + b; its parameters are "weight" (outputs, inputs) and "bias" (outputs).
class Linear : public torch::nn::Module, public PrecisionLayer {
 public:
  Linear(const LinearSizes& sizes, const ParameterPlacement& placement);
  torch::Tensor forward(const torch::Tensor& x) const;  // (..., inputs) -> (..., outputs)
  // Returns parts first .. first + count - 1 of the outputs.
  torch::Tensor forward_parts(const torch::Tensor& x, int64_t first, int64_t count) const;
  void use_precision(const LayerPrecision& precision) override;
  bool learn_in(ComputePrecision precision) override;

  torch::Tensor weight;
  torch::Tensor bias;  // undefined without bias

 private:
  int64_t parts_;
  LinearPacking packing_;
  ComputePrecision learning_precision_ = ComputePrecision::kFloat32;
  std::unique_ptr<const PackedLayer> packed_;  // of use_precision on the CPU, else null
  torch::Tensor rounded_;                      // of use_precision elsewhere: the weight in bfloat16
};

// LayerNorm over the last dimension; parameters "weight" and "bias" (channels).
class LayerNorm : public torch::nn::Module {
 public:
  LayerNorm(int64_t channels, double epsilon, const ParameterPlacement& placement);
  torch::Tensor forward(const torch::Tensor& x) const;

  torch::Tensor weight;
  torch::Tensor bias;

 private:
  double epsilon_;
};

// RMSNorm over the last dimension: x / sqrt(mean(x^2) + epsilon) * weight; parameter "weight" (channels). Exact to
// rounding for any finite x: rows whose square would overflow or vanish are scaled by a power of two first.
class RmsNorm : public torch::nn::Module {
 public:
  RmsNorm(int64_t channels, double epsilon, const ParameterPlacement& placement);
  torch::Tensor forward(const torch::Tensor& x) const;

  torch::Tensor weight;
  double epsilon() const { return epsilon_; }

 private:
  double epsilon_;
};

struct PatchEmbedSizes {
  int64_t in_channels = 0;
  int64_t embed_dim = 0;
  int64_t patch_size = 1;
};

// A convolution whose kernel equals its stride, kept as the checkpoint's "proj.weight" (embed_dim, in_channels, p, p)
// and "proj.bias" and computed as one matrix product.
class PatchEmbed : public torch::nn::Module {
 public:
  PatchEmbed(const PatchEmbedSizes& sizes, const ParameterPlacement& placement);
  // (views, in_channels, height, width) -> (views, tokens, embed_dim), row-major token grid.
  torch::Tensor forward_image(const torch::Tensor& image) const;
  // (views, tokens, in_channels) -> (views, tokens, embed_dim); needs patch_size 1.
  torch::Tensor forward_tokens(const torch::Tensor& tokens) const;

  torch::Tensor weight;  // registered under the child "proj"
  torch::Tensor bias;

 private:
  PatchEmbedSizes sizes_;
};

}  // namespace gld
