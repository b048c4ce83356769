#pragma once

// Four floats and their transposition, for packing; compiled once per instruction set (see simd.h).

#include "gld/kernels/simd.h"

#include <cstdint>

namespace gld {
namespace {

constexpr float kLowest = -__builtin_inff();

GLD_INLINE int64_t round_up(int64_t value, int64_t multiple) {
  return (value + multiple - 1) / multiple * multiple;
}

typedef float Quad __attribute__((vector_size(16)));

GLD_INLINE Quad load_quad(const float* p) {
  Quad q;
  __builtin_memcpy(&q, p, sizeof(q));
  return q;
}

GLD_INLINE void store_quad(float* p, Quad q) { __builtin_memcpy(p, &q, sizeof(q)); }

GLD_INLINE void transpose_quads(Quad (&q)[4]) {
  const Quad a = __builtin_shufflevector(q[0], q[1], 0, 4, 1, 5);
  const Quad b = __builtin_shufflevector(q[0], q[1], 2, 6, 3, 7);
  const Quad c = __builtin_shufflevector(q[2], q[3], 0, 4, 1, 5);
  const Quad d = __builtin_shufflevector(q[2], q[3], 2, 6, 3, 7);
  q[0] = __builtin_shufflevector(a, c, 0, 1, 4, 5);
  q[1] = __builtin_shufflevector(a, c, 2, 3, 6, 7);
  q[2] = __builtin_shufflevector(b, d, 0, 1, 4, 5);
  q[3] = __builtin_shufflevector(b, d, 2, 3, 6, 7);
}

}  // namespace
}  // namespace gld
