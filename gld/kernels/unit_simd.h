#pragma once

// What matrix units need of vectors beside simd.h: whole numbers, bfloat16 and bytes. Compiled once per unit, like
// simd.h and with the same rules.

#include "gld/kernels/kernel_table.h"
#include "gld/kernels/matrix_unit_kernels.h"
#include "gld/kernels/simd.h"

namespace gld {
namespace {

enum class OperandKind { kBFloat16, kInt8 };

// Rounds to the nearest, ties to even; a NaN stays one.
GLD_INLINE uint16_t bfloat16_of(float x) {
  uint32_t bits;
  __builtin_memcpy(&bits, &x, sizeof(bits));
  if ((bits & 0x7fffffffU) > 0x7f800000U) return static_cast<uint16_t>(bits >> 16 | 0x40U);
  return static_cast<uint16_t>((bits + 0x7fffU + (bits >> 16 & 1U)) >> 16);
}

GLD_INLINE float float_of(uint16_t bfloat16) {
  const uint32_t bits = static_cast<uint32_t>(bfloat16) << 16;
  float x;
  __builtin_memcpy(&x, &bits, sizeof(x));
  return x;
}

#if defined(__AVX512BF16__)

struct UnitSimd {
  // Returns (sums - zero * column_sums) as floats; sums are int32 in the lanes of a Vector.
  static GLD_INLINE Vector without_zero(Vector sums, int32_t zero, const int32_t* column_sums) {
    const __m512i of_zero = _mm512_mullo_epi32(_mm512_set1_epi32(zero), _mm512_loadu_si512(column_sums));
    return _mm512_cvtepi32_ps(_mm512_sub_epi32(_mm512_castps_si512(sums), of_zero));
  }
  // Word i of y has first[i] in the lower half and second[i] in the upper one.
  static GLD_INLINE void store_pairs(uint32_t* y, Vector first, Vector second) {
    const __m512i halves = reinterpret_cast<__m512i>(_mm512_cvtne2ps_pbh(second, first));
    const __m512i order = _mm512_set_epi16(31, 15, 30, 14, 29, 13, 28, 12, 27, 11, 26, 10, 25, 9, 24, 8, 23,
                                           7, 22, 6, 21, 5, 20, 4, 19, 3, 18, 2, 17, 1, 16, 0);
    _mm512_storeu_si512(y, _mm512_permutexvar_epi16(order, halves));
  }
  static GLD_INLINE void store_bfloat16(uint16_t* y, Vector x) {
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(y), reinterpret_cast<__m256i>(_mm512_cvtneps_pbh(x)));
  }
  // Stores clamp(round(x * inverse) + zero, 0, 255).
  static GLD_INLINE void store_bytes(uint8_t* y, Vector x, float inverse, int32_t zero) {
    __m512i whole = _mm512_cvtps_epi32(Simd::multiply(x, Simd::broadcast(inverse)));
    whole = _mm512_max_epi32(_mm512_add_epi32(whole, _mm512_set1_epi32(zero)), _mm512_setzero_si512());
    _mm_storeu_si128(reinterpret_cast<__m128i*>(y), _mm512_cvtusepi32_epi8(whole));
  }
  // Returns 2^x for x of at most about 0, to 9e-5 relative, finer than the bfloat16 that it becomes by a factor of 20;
  // 2^0 = 1 exactly.
  static GLD_INLINE Vector exp2(Vector x) {
    const Vector r = _mm512_reduce_ps(x, _MM_FROUND_TO_NEG_INF);
    Vector p = Simd::broadcast(0.07706717f);
    p = Simd::multiply_add(p, r, Simd::broadcast(0.22764486f));
    p = Simd::multiply_add(p, r, Simd::broadcast(0.69511682f));
    p = Simd::multiply_add(p, r, Simd::broadcast(1.0f));
    return _mm512_scalef_ps(p, x);
  }
};

#else

struct UnitSimd {
  static GLD_INLINE Vector without_zero(Vector sums, int32_t zero, const int32_t* column_sums) {
    int32_t whole[Simd::lanes];
    float x[Simd::lanes];
    __builtin_memcpy(whole, &sums, sizeof(whole));
    for (int i = 0; i < Simd::lanes; ++i) x[i] = static_cast<float>(whole[i] - zero * column_sums[i]);
    return Simd::load(x);
  }
  static GLD_INLINE void store_pairs(uint32_t* y, Vector first, Vector second) {
    float low[Simd::lanes], high[Simd::lanes];
    Simd::store(low, first);
    Simd::store(high, second);
    for (int i = 0; i < Simd::lanes; ++i) {
      y[i] = static_cast<uint32_t>(bfloat16_of(high[i])) << 16 | bfloat16_of(low[i]);
    }
  }
  static GLD_INLINE void store_bfloat16(uint16_t* y, Vector x) {
    float values[Simd::lanes];
    Simd::store(values, x);
    for (int i = 0; i < Simd::lanes; ++i) y[i] = bfloat16_of(values[i]);
  }
  static GLD_INLINE void store_bytes(uint8_t* y, Vector x, float inverse, int32_t zero) {
    float values[Simd::lanes];
    Simd::store(values, x);
    for (int i = 0; i < Simd::lanes; ++i) {
      // A row with a NaN or an infinity has no scale, and bytes that nobody looks at.
      const float scaled = values[i] * inverse;
      const float inside = scaled > -256 && scaled < 256 ? scaled : 0;
      const auto byte = static_cast<int32_t>(__builtin_nearbyintf(inside)) + zero;
      y[i] = static_cast<uint8_t>(byte < 0 ? 0 : byte > 255 ? 255 : byte);
    }
  }
  static GLD_INLINE Vector exp2(Vector x) { return Simd::exp2(x); }
};

#endif

}  // namespace
}  // namespace gld
