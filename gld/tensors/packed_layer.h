#pragma once

#include "gld/kernels/packed_product.h"

#include <cstdint>
#include <vector>

#include <torch/types.h>

namespace gld {

// The weights of a linear layer, packed once for one precision (gld/kernels/packed_product.h), for float32 tensors on
// the CPU while no gradients are recorded. In float32 its results are those of times_transposed, bit for bit.
class PackedLayer {
 public:
  // weight is (outputs, inputs), float32 on the CPU. parts are equal shares of the outputs that can be computed apart.
  PackedLayer(const torch::Tensor& weight, int64_t parts, ComputePrecision precision);

  // Returns whether packing such weights is worth anything: in float32 not for few inputs.
  static bool applies(const torch::Tensor& weight, ComputePrecision precision);

  // Returns x weight^T + bias for parts first .. first + count - 1: (..., inputs) -> (..., count shares of outputs).
  // bias is of all outputs, or undefined.
  torch::Tensor times(const torch::Tensor& x, const torch::Tensor& bias, int64_t first, int64_t count) const;
  int64_t parts() const { return static_cast<int64_t>(parts_.size()); }
  int64_t bytes() const;

 private:
  torch::Tensor unpacked(int64_t first, int64_t count) const;

  std::vector<PackedWeights> parts_;
  int64_t outputs_a_part_;
};

}  // namespace gld
