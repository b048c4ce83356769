#pragma once

#include "gld/machine/matrix_unit.h"

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

// The same for float32 x and bias and a weight in bfloat16, by LibTorch: x is rounded to bfloat16, LibTorch's kernel
// sums, and the product is rounded to bfloat16 once before the bias is added. Returns float32.
torch::Tensor times_rounded(const torch::Tensor& x, const torch::Tensor& weight,
                            const torch::Tensor& bias = {});
// Whether a layer with that float32 weight computes so: in bfloat16 where it is not on the CPU, which has kernels of
// ours (packed_layer.h).
bool rounded_product_applies(const torch::Tensor& weight, ComputePrecision precision);

}  // namespace gld
