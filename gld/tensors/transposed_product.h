#pragma once

#include <torch/types.h>

namespace gld {

// Products of fewer rows or inputs are LibTorch's: packing the weights is not worth its time beside them.
constexpr int64_t kFewestProductRows = 48;
constexpr int64_t kFewestProductInputs = 32;

// x weight^T + bias: (..., inputs) with (outputs, inputs) and (outputs) -> (..., outputs); bias may be undefined. In
// float32 on the CPU, while no gradients are recorded and there are rows enough, by gld/kernels/matrix_product.h;
// otherwise by LibTorch.
torch::Tensor times_transposed(const torch::Tensor& x, const torch::Tensor& weight,
                               const torch::Tensor& bias = {});

}  // namespace gld
