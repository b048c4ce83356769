#pragma once

#include "gld/files/dtype.h"

#include <cstdint>

namespace gld {

// How an HDF5 dataset stores its numbers.
struct Hdf5Elements {
  DType dtype = DType::kFloat32;  // a number; neither bool nor bfloat16
  bool swapped = false;           // big-endian
  uint64_t size() const { return static_cast<uint64_t>(byte_size(dtype)); }  // bytes
};

// Reads count stored numbers, in any alignment, as floats. A double beyond the floats becomes infinite.
void floats_from(const Hdf5Elements& elements, const uint8_t* from, uint64_t count, float* to);

}  // namespace gld
