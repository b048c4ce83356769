#pragma once

#include "gld/kernels/attention_kernel.h"

#include <cstdint>

// Linear layers on the CPU in float32, on plain pointers. Weights are packed as they are used, which costs little
// beside some dozens of rows; there is no thread pool of its own to fight with the others (a BLAS brings one).
namespace gld {

struct LinearProduct {
  int64_t rows = 0;
  int64_t inputs = 0;
  int64_t outputs = 0;
  const float* x = nullptr;  // (rows, inputs), rows x_stride floats apart
  int64_t x_stride = 0;
  const float* weight = nullptr;  // (outputs, inputs), rows weight_stride floats apart
  int64_t weight_stride = 0;
  const float* bias = nullptr;  // (outputs), or null
  float* y = nullptr;           // (rows, outputs), rows y_stride floats apart; overlaps nothing
  int64_t y_stride = 0;
};

// y = x weight^T + bias. The same bits for any number of threads.
void linear_product(const LinearProduct& product, const KernelSettings& settings);

}  // namespace gld
