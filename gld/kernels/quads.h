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

// rows (count, stride) = factors (per lane) times transposed (head_dim, lanes). head_dim is a multiple of 4.
template <int64_t lanes>
GLD_INLINE void transpose_back(const float* transposed, const float* factors, int64_t count, int64_t stride,
                               int64_t head_dim, float* rows) {
  for (int64_t lane = 0; lane < count; lane += 4) {
    const Quad factor = load_quad(factors + lane);
    for (int64_t c = 0; c < head_dim; c += 4) {
      Quad q[4];
#pragma GCC unroll 4
      for (int i = 0; i < 4; ++i) q[i] = load_quad(transposed + (c + i) * lanes + lane) * factor;
      transpose_quads(q);
      for (int i = 0; i < 4 && lane + i < count; ++i) store_quad(rows + (lane + i) * stride + c, q[i]);
    }
  }
}

}  // namespace
}  // namespace gld
