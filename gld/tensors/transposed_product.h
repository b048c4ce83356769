#pragma once

#include "gld/machine/matrix_unit.h"

#include <torch/types.h>

namespace gld {

// Returns x weight^T + bias: (..., inputs) with (outputs, inputs) and (outputs) -> (..., outputs); bias may be
// undefined. In float32 on the CPU, while no gradients are recorded, that is by gld/kernels/matrix_product.h: the same
// bits for any number of threads, which a BLAS does not promise, and on which the equal bits of several processes rest.
// Otherwise it is by LibTorch.
torch::Tensor times_transposed(const torch::Tensor& x, const torch::Tensor& weight,
                               const torch::Tensor& bias = {});

// Does the same for float32 x and bias and a weight in bfloat16, by LibTorch: x is rounded to bfloat16, LibTorch's
// kernel sums, and the product is rounded to bfloat16 once at most before the bias is added (bfloat16_product in
// torch_version.h). Returns float32.
torch::Tensor times_rounded(const torch::Tensor& x, const torch::Tensor& weight,
                            const torch::Tensor& bias = {});
// Returns whether a layer with that float32 weight computes so: in bfloat16 where it is not on the CPU, which has
// kernels of ours (packed_layer.h).
bool rounded_product_applies(const torch::Tensor& weight, ComputePrecision precision);

}  // namespace gld
