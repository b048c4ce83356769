#pragma once

#include "gld/machine/matrix_unit.h"

#include <torch/types.h>

namespace gld {

// Returns x weight^T + bias as times_transposed (transposed_product.h) does, differentiable, in a reduced precision:
// the product itself, the gradient of x (a product with weight) and that of weight (a product of the result's gradient
// with x) all round their operands to `precision`, with float32 sums. bias, its gradient and everything stored are
// float32. It takes float32 tensors on the CPU, and bfloat16 alone: the scales of int8 are of a whole row and lose
// small gradients. There are first derivatives only. Any number of threads gives the same bits.
torch::Tensor learning_product(const torch::Tensor& x, const torch::Tensor& weight, const torch::Tensor& bias,
                               ComputePrecision precision);

// Returns whether learning_product can be used for these: float32 on the CPU.
bool learning_product_applies(const torch::Tensor& x, const torch::Tensor& weight);

}  // namespace gld
