#pragma once

#include "gld/kernels/aligned_floats.h"
#include "gld/kernels/attention_kernel.h"
#include "gld/machine/matrix_unit.h"

#include <cstdint>
#include <vector>

// Linear layers on the CPU whose weights are packed once, in any precision, on plain pointers.
namespace gld {

struct WeightMatrix {
  const float* data = nullptr;  // (outputs, inputs), rows `stride` floats apart
  int64_t outputs = 0;
  int64_t inputs = 0;
  int64_t stride = 0;
};

struct PackingSettings {
  ComputePrecision precision = ComputePrecision::kFloat32;
  MatrixUnit unit = MatrixUnit::kPlain;                     // for any precision but float32
  InstructionSet instruction_set = best_instruction_set();  // for float32
  int64_t second_level_cache = second_level_cache_bytes();
  int threads = 1;
};
// Returns settings with the best unit of this processor.
PackingSettings packing_settings(ComputePrecision precision, int threads);

// Weights as the kernels of one precision and unit read them. Immutable; may be used from several threads.
class PackedWeights {
 public:
  PackedWeights(const WeightMatrix& weights, const PackingSettings& settings);

  const PackingSettings& settings() const { return settings_; }
  int64_t outputs() const { return outputs_; }
  int64_t inputs() const { return inputs_; }
  int64_t bytes() const;
  // Returns the bytes that such weights will take.
  static int64_t bytes(int64_t outputs, int64_t inputs, const PackingSettings& settings);
  // Writes the weights again, with the same bits, for float32 only. weights is (outputs, inputs), contiguous.
  void unpack(float* weights) const;

  // For the kernels. float32: panels of (depth, tile_lanes) by blocks of inputs, those by blocks of outputs. Others:
  // panels of (words, lanes) by blocks of words.
  const float* floats() const { return data_.data(); }
  const uint32_t* words() const { return reinterpret_cast<const uint32_t*>(data_.data()); }
  const float* column_scales() const { return column_scales_.data(); }  // (padded outputs), int8
  const int32_t* column_sums() const {
    return column_sums_.data();
  }  // (blocks of words, padded outputs), int8

 private:
  PackingSettings settings_;
  int64_t outputs_, inputs_;
  AlignedFloats data_;
  std::vector<float> column_scales_;
  std::vector<int32_t> column_sums_;
};

// y = x weights^T + bias for one matrix; several that share x are computed together, which converts x once.
struct ProductTarget {
  const PackedWeights* weights = nullptr;
  const float* bias = nullptr;  // (outputs), or null
  float* y = nullptr;  // (rows, outputs), rows PackedProduct::y_stride floats apart; overlaps nothing
};
struct PackedProduct {
  int64_t rows = 0;
  const float* x = nullptr;  // (rows, inputs), rows x_stride floats apart
  int64_t x_stride = 0;
  int64_t y_stride = 0;
  std::vector<ProductTarget> targets;  // of equal inputs, precision and unit
};

// Any number of threads and of rows gives the same bits; in float32 they are those of linear_product
// (matrix_product.h). A row with a NaN or an infinity gives a row of NaN in int8, and in other precisions what IEEE
// arithmetic gives.
void packed_product(const PackedProduct& product, int threads);

// Returns the operations a second of the unit (float32: of the instruction set) in registers, the peak that shares
// refer to.
double measure_precision_peak(ComputePrecision precision, int threads);

}  // namespace gld
