#pragma once

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// How a module's parameters are drawn before training. Applies to every parameter below the module, by its
// last name and shape: vectors named "weight" and "gamma" (norms, layer scales) become 1, other vectors
// (biases) 0, matrices and convolution kernels are drawn by `matrices`.
enum class MatrixInitialisation {
  kTruncatedNormal,  // standard deviation 0.02, cut at two deviations (DINOv2)
  kXavierUniform,    // +-sqrt(6 / (fan in + fan out)) (the RGB decoder)
  kFanInUniform,     // +-1 / sqrt(fan in) (PyTorch's default for convolutions)
};

// Draws on the CPU in the order of the parameters' names, so the result does not depend on the device.
void initialise_parameters(torch::nn::Module& module, MatrixInitialisation matrices,
                           const torch::Generator& generator);

// Fills one tensor from a normal distribution cut at two standard deviations.
void fill_truncated_normal(torch::Tensor& tensor, double deviation, const torch::Generator& generator);

}  // namespace gld
