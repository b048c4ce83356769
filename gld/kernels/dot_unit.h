#pragma once

// AVX512-BF16 and AVX512-VNNI multiply a word of the left operand, broadcast, with 16 lanes of the right one.

#include "gld/kernels/unit_simd.h"

namespace gld {
namespace {

struct DotUnit {
  static constexpr int rows = 8;  // 8 x 3 accumulators leave 8 of 32 registers for operands
  static constexpr int vectors = 3;
  static constexpr int64_t lanes = vectors * Simd::lanes;
  static constexpr int64_t step_words = 1;
  // 192 columns of 768 words are 576 KiB of a second-level cache of 1 MiB, as in float32 (matrix_product.cpp).
  static constexpr int64_t block_words = 768;
  static constexpr int64_t block_columns = 192;

  // Nothing to set up.
  struct Session {};

  // The instruction is named because g++ would otherwise move sums between registers (simd.h). Sums of int8 are int32
  // in the bits of a Vector.
  template <OperandKind kind>
  static GLD_INLINE Vector accumulate(Vector a, Vector b, Vector sum) {
    if constexpr (kind == OperandKind::kBFloat16) {
      asm("vdpbf16ps %2, %1, %0" : "+v"(sum) : "v"(a), "v"(b));
    } else {
      asm("vpdpbusd %2, %1, %0" : "+v"(sum) : "v"(a), "v"(b));
    }
    return sum;
  }

  template <OperandKind kind>
  static GLD_INLINE void step(const uint32_t* a, int64_t a_stride, const uint32_t* b,
                              Vector (&c)[rows][vectors]) {
    Vector operand[vectors];
#pragma GCC unroll 8
    for (int n = 0; n < vectors; ++n) operand[n] = _mm512_loadu_ps(b + n * Simd::lanes);
#pragma GCC unroll 8
    for (int m = 0; m < rows; ++m) {
      float word;
      __builtin_memcpy(&word, a + m * a_stride, sizeof(word));
      const Vector factor = Simd::broadcast(word);
#pragma GCC unroll 8
      for (int n = 0; n < vectors; ++n) c[m][n] = accumulate<kind>(factor, operand[n], c[m][n]);
    }
  }

  // Calls finish(row, vector, sums) for every register of sums over `words` words. b_stride is the words from one to
  // the next of b.
  template <OperandKind kind, class Finish>
  static GLD_INLINE void multiply(int64_t words, const uint32_t* a, int64_t a_stride, const uint32_t* b,
                                  int64_t b_stride, const Finish& finish) {
    Vector c[rows][vectors];
    clear_tile(c);
    int64_t k = 0;
    for (; k + 4 <= words; k += 4) {
      step<kind>(a + k, a_stride, b, c);
      step<kind>(a + k + 1, a_stride, b + b_stride, c);
      step<kind>(a + k + 2, a_stride, b + 2 * b_stride, c);
      step<kind>(a + k + 3, a_stride, b + 3 * b_stride, c);
      b += 4 * b_stride;
    }
    for (; k < words; ++k, b += b_stride) step<kind>(a + k, a_stride, b, c);
#pragma GCC unroll 8
    for (int m = 0; m < rows; ++m) {
#pragma GCC unroll 8
      for (int n = 0; n < vectors; ++n) finish(m, n, c[m][n]);
    }
  }

  template <OperandKind kind>
  static double rounds(int64_t count) {
    constexpr int kRepeats = 4;
    Vector c[rows][vectors];
    clear_tile(c);
    Vector factor = Simd::zero();
    for (int64_t round = 0; round < count; ++round) {
      asm volatile("" : "+v"(factor));
#pragma GCC unroll 4
      for (int repeat = 0; repeat < kRepeats; ++repeat) {
#pragma GCC unroll 8
        for (int m = 0; m < rows; ++m) {
#pragma GCC unroll 8
          for (int n = 0; n < vectors; ++n) c[m][n] = accumulate<kind>(factor, factor, c[m][n]);
        }
      }
    }
    Vector sum = Simd::zero();
#pragma GCC unroll 8
    for (int m = 0; m < rows; ++m) {
#pragma GCC unroll 8
      for (int n = 0; n < vectors; ++n) sum = Simd::add(sum, c[m][n]);
    }
    asm volatile("" : "+v"(sum));
    const double numbers_a_word = kind == OperandKind::kBFloat16 ? 2 : 4;
    return static_cast<double>(count) * kRepeats * rows * static_cast<double>(lanes) * 2 * numbers_a_word;
  }
};

}  // namespace
}  // namespace gld
