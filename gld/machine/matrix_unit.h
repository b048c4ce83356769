#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// What matrix products and attention are computed in. Sums are float32 (int32 for int8) in all of them; softmax, norms,
// residual stream, camera encoding, statistics and the flow's state are float32 whatever is chosen.
//   float32   as before there were others, bit for bit
//   bfloat16  operands rounded to 8 significant bits
//   int8      linear layers with a scale an output channel and a scale and zero a token; attention in bfloat16
enum class ComputePrecision { kFloat32, kBFloat16, kInt8 };

// Returns "float32", "bfloat16", "int8", in that order.
const std::vector<std::string>& compute_precision_names();
const std::string& compute_precision_name(ComputePrecision precision);

// What multiplies bfloat16 or int8 numbers:
//   plain   a tile unit in portable code, slower than float32: for checks, and so that every precision runs everywhere
//   AVX512  dot products in vectors: AVX512-BF16 (twice the float32 rate on Zen 4 and 5) and AVX512-VNNI (four times)
//   AMX     16 x 16 tiles: AMX-BF16 and AMX-INT8
enum class MatrixUnit { kPlain, kAvx512, kAmx };

// Returns what this processor, its kernel and this build offer for a precision, best last; it is never empty. For
// float32, which has kernels of its own (instruction_set.h), it is kPlain alone.
std::vector<MatrixUnit> available_matrix_units(ComputePrecision precision);
MatrixUnit best_matrix_unit(ComputePrecision precision);
// Returns whether the precision is worth choosing for its speed here: float32, or one that a unit other than kPlain
// computes.
bool has_matrix_unit(ComputePrecision precision);

// Returns "plain", "AVX512" or "AMX".
std::string matrix_unit_name(MatrixUnit unit);
// Returns the same with its instructions: "AVX512-BF16", "AVX512-VNNI", "AMX-BF16", "AMX-INT8".
std::string matrix_unit_name(MatrixUnit unit, ComputePrecision precision);

}  // namespace gld
