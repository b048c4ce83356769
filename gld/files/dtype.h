#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

namespace gld {

// Element types of tensors on file (safetensors, PyTorch, NumPy). Files and memory are little-endian.
enum class DType {
  kFloat64,
  kFloat32,
  kFloat16,
  kBFloat16,
  kInt64,
  kInt32,
  kInt16,
  kInt8,
  kUInt64,
  kUInt32,
  kUInt16,
  kUInt8,
  kBool,
};

// A tensor on file may have this many dimensions at most.
constexpr size_t kMaximumRank = 64;

int64_t byte_size(DType dtype);
bool is_floating(DType dtype);
// Returns "float32", "bfloat16", "int64", "bool", ...
std::string dtype_name(DType dtype);

// Returns the exact value of a half-precision number given by its bits.
float float_from_half(uint16_t bits);
float float_from_bfloat16(uint16_t bits);

}  // namespace gld
