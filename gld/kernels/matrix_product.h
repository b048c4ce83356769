#pragma once

#include "gld/kernels/attention_kernel.h"

#include <cstdint>

// Linear layers on the CPU in float32, on plain pointers. Weights are packed as they are used, which costs little
// beside some dozens of rows, or were packed before (packed_product.h); there is no thread pool of its own to fight
// with the others (a BLAS brings one).
namespace gld {

struct LinearProduct {
  int64_t rows = 0;
  int64_t inputs = 0;
  int64_t outputs = 0;
  const float* x = nullptr;  // (rows, inputs), rows x_stride floats apart
  int64_t x_stride = 0;
  const float* weight = nullptr;  // (outputs, inputs), rows weight_stride floats apart
  int64_t weight_stride = 0;
  const float* packed_weight = nullptr;  // of pack_weight, then weight is not read; or null
  const float* bias = nullptr;           // (outputs), or null
  float* y = nullptr;                    // (rows, outputs), rows y_stride floats apart; overlaps nothing
  int64_t y_stride = 0;
};

// Computes y = x weight^T + bias. Any number of threads gives the same bits.
void linear_product(const LinearProduct& product, const KernelSettings& settings);

// Computes the same without packing, for few rows: below kFewestPackedRows it is the faster one. packed_weight is not
// read. Any number of threads and of rows gives the same bits, but not those of linear_product, whose sums are cut
// elsewhere.
void few_rows_product(const LinearProduct& product, const KernelSettings& settings);
constexpr int64_t kFewestPackedRows = 48;

// These make the weights of product as linear_product reads them with the same instruction set and cache,
// (packed_weight_floats); products with them give the same bits.
int64_t packed_weight_floats(int64_t outputs, int64_t inputs, const KernelSettings& settings);
void pack_weight(const LinearProduct& product, const KernelSettings& settings, float* packed);
// Unpacks from product.packed_weight back into (outputs, inputs).
void unpack_weight(const LinearProduct& product, const KernelSettings& settings, float* weight);

}  // namespace gld
