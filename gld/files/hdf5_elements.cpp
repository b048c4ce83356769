#include "gld/files/hdf5_elements.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <type_traits>

namespace gld {
namespace {

template <class T>
T element(const uint8_t* from, bool swapped) {
  uint8_t bytes[sizeof(T)];
  if (swapped) {
    std::reverse_copy(from, from + sizeof(T), bytes);
  } else {
    std::copy(from, from + sizeof(T), bytes);
  }
  T value;
  std::memcpy(&value, bytes, sizeof value);
  return value;
}

// A double beyond the floats is infinite, which a plain cast would leave undefined.
template <class T>
float to_float(T value) {
  if constexpr (std::is_same_v<T, double>) {
    constexpr double kLargest = std::numeric_limits<float>::max();
    if (value > kLargest) return std::numeric_limits<float>::infinity();
    if (value < -kLargest) return -std::numeric_limits<float>::infinity();
  }
  return static_cast<float>(value);
}

template <class T>
void convert(const uint8_t* from, bool swapped, uint64_t count, float* to) {
  for (uint64_t i = 0; i < count; ++i) to[i] = to_float(element<T>(from + sizeof(T) * i, swapped));
}

}  // namespace

void floats_from(const Hdf5Elements& elements, const uint8_t* from, uint64_t count, float* to) {
  const bool swapped = elements.swapped;
  switch (elements.dtype) {
    case DType::kFloat64:
      return convert<double>(from, swapped, count, to);
    case DType::kFloat32:
      return convert<float>(from, swapped, count, to);
    case DType::kInt64:
      return convert<int64_t>(from, swapped, count, to);
    case DType::kInt32:
      return convert<int32_t>(from, swapped, count, to);
    case DType::kInt16:
      return convert<int16_t>(from, swapped, count, to);
    case DType::kInt8:
      return convert<int8_t>(from, swapped, count, to);
    case DType::kUInt64:
      return convert<uint64_t>(from, swapped, count, to);
    case DType::kUInt32:
      return convert<uint32_t>(from, swapped, count, to);
    case DType::kUInt16:
      return convert<uint16_t>(from, swapped, count, to);
    case DType::kUInt8:
      return convert<uint8_t>(from, swapped, count, to);
    default:
      break;
  }
  for (uint64_t i = 0; i < count; ++i) to[i] = float_from_half(element<uint16_t>(from + 2 * i, swapped));
}

}  // namespace gld
