#pragma once

// One vector of floats for whichever instruction set the including file is compiled for. Only files compiled
// once per instruction set include this: everything in it has internal linkage, and no standard-library
// template is used, whose weak symbols the linker could pick for code that must run everywhere.

#include <cstddef>
#include <cstdint>

#if defined(__AVX2__) || defined(__AVX512F__)
#include <immintrin.h>
#endif

#define GLD_INLINE inline __attribute__((always_inline))

namespace gld {
namespace {

#if defined(__AVX512F__)

struct Simd {
  using Vector = __m512;
  static constexpr int lanes = 16;
  static constexpr int tile_rows = 8;  // 8 x 3 accumulators leave 8 of 32 registers for operands
  static constexpr int tile_vectors = 3;

  static GLD_INLINE Vector zero() { return _mm512_setzero_ps(); }
  static GLD_INLINE Vector broadcast(float x) { return _mm512_set1_ps(x); }
  static GLD_INLINE Vector load(const float* p) { return _mm512_loadu_ps(p); }
  static GLD_INLINE void store(float* p, Vector v) { _mm512_storeu_ps(p, v); }
  static GLD_INLINE Vector add(Vector a, Vector b) { return _mm512_add_ps(a, b); }
  static GLD_INLINE Vector subtract(Vector a, Vector b) { return _mm512_sub_ps(a, b); }
  static GLD_INLINE Vector multiply(Vector a, Vector b) { return _mm512_mul_ps(a, b); }
  static GLD_INLINE Vector divide(Vector a, Vector b) { return _mm512_div_ps(a, b); }
  static GLD_INLINE Vector multiply_add(Vector a, Vector b, Vector c) { return _mm512_fmadd_ps(a, b, c); }
  static GLD_INLINE Vector accumulate(Vector a, Vector b, Vector sum) {
    asm("vfmadd231ps %2, %1, %0" : "+v"(sum) : "v"(a), "v"(b));
    return sum;
  }
  static GLD_INLINE Vector maximum(Vector a, Vector b) { return _mm512_max_ps(a, b); }
  // Returns element j of every group of four, in all four places.
  template <int j>
  static GLD_INLINE Vector spread(Vector a) {
    return _mm512_permute_ps(a, j * 0x55);
  }
  static GLD_INLINE Vector load_repeated4(const float* p) { return _mm512_broadcast_f32x4(_mm_loadu_ps(p)); }
  static GLD_INLINE float sum(Vector a) { return _mm512_reduce_add_ps(a); }

  // Returns 2^x to 1.5e-7 relative, 2^0 = 1 exactly, 0 below the range of float. The fraction x - floor(x) goes through
  // a polynomial (minimax in relative error with constant term 1: 8.2e-8), vscalefps multiplies by 2^floor(x).
  static GLD_INLINE Vector exp2(Vector x) {
    const Vector r = _mm512_reduce_ps(x, _MM_FROUND_TO_NEG_INF);
    Vector p = broadcast(0.001867130072f);
    p = multiply_add(p, r, broadcast(0.009017030316f));
    p = multiply_add(p, r, broadcast(0.05579991311f));
    p = multiply_add(p, r, broadcast(0.2401644502f));
    p = multiply_add(p, r, broadcast(0.6931513118f));
    p = multiply_add(p, r, broadcast(1.0f));
    return _mm512_scalef_ps(p, x);
  }
};

#elif defined(__AVX2__)

struct Simd {
  using Vector = __m256;
  static constexpr int lanes = 8;
  static constexpr int tile_rows = 4;  // 4 x 3 accumulators, 3 operands and a broadcast fill the 16 registers
  static constexpr int tile_vectors = 3;

  static GLD_INLINE Vector zero() { return _mm256_setzero_ps(); }
  static GLD_INLINE Vector broadcast(float x) { return _mm256_set1_ps(x); }
  static GLD_INLINE Vector load(const float* p) { return _mm256_loadu_ps(p); }
  static GLD_INLINE void store(float* p, Vector v) { _mm256_storeu_ps(p, v); }
  static GLD_INLINE Vector add(Vector a, Vector b) { return _mm256_add_ps(a, b); }
  static GLD_INLINE Vector subtract(Vector a, Vector b) { return _mm256_sub_ps(a, b); }
  static GLD_INLINE Vector multiply(Vector a, Vector b) { return _mm256_mul_ps(a, b); }
  static GLD_INLINE Vector divide(Vector a, Vector b) { return _mm256_div_ps(a, b); }
  static GLD_INLINE Vector multiply_add(Vector a, Vector b, Vector c) { return _mm256_fmadd_ps(a, b, c); }
  static GLD_INLINE Vector accumulate(Vector a, Vector b, Vector sum) {
    asm("vfmadd231ps %2, %1, %0" : "+x"(sum) : "x"(a), "x"(b));
    return sum;
  }
  static GLD_INLINE Vector maximum(Vector a, Vector b) { return _mm256_max_ps(a, b); }
  template <int j>
  static GLD_INLINE Vector spread(Vector a) {
    return _mm256_permute_ps(a, j * 0x55);
  }
  static GLD_INLINE Vector load_repeated4(const float* p) {
    return _mm256_broadcast_ps(reinterpret_cast<const __m128*>(p));
  }
  static GLD_INLINE float sum(Vector a) {
    __m128 s = _mm_add_ps(_mm256_castps256_ps128(a), _mm256_extractf128_ps(a, 1));
    s = _mm_add_ps(s, _mm_movehl_ps(s, s));
    return _mm_cvtss_f32(_mm_add_ss(s, _mm_shuffle_ps(s, s, 1)));
  }

  // Returns 2^x to 1.2e-7 relative for x in [-126, 127], clamped outside, with NaN kept (the operand order of max and
  // min does that). Adding 1.5 * 2^23 rounds to the nearest integer and leaves it in the low bits, which then go to the
  // exponent.
  static GLD_INLINE Vector exp2(Vector x) {
    x = _mm256_min_ps(broadcast(127.0f), _mm256_max_ps(broadcast(-126.0f), x));
    const Vector shifter = broadcast(12582912.0f);
    const Vector shifted = add(x, shifter);
    const Vector r = subtract(x, subtract(shifted, shifter));
    Vector p = broadcast(0.0001559467758f);
    p = multiply_add(p, r, broadcast(0.001340664391f));
    p = multiply_add(p, r, broadcast(0.009617692975f));
    p = multiply_add(p, r, broadcast(0.05550310551f));
    p = multiply_add(p, r, broadcast(0.2402265278f));
    p = multiply_add(p, r, broadcast(0.693147215f));
    p = multiply_add(p, r, broadcast(1.0f));
    return _mm256_castsi256_ps(
        _mm256_add_epi32(_mm256_castps_si256(p), _mm256_slli_epi32(_mm256_castps_si256(shifted), 23)));
  }
};

#else

// The vector extensions of gcc and clang, which become whatever the target has.
struct Simd {
  typedef float Vector __attribute__((vector_size(16)));
  typedef int32_t Integers __attribute__((vector_size(16)));
  static constexpr int lanes = 4;
  static constexpr int tile_rows = 4;
  static constexpr int tile_vectors = 2;

  static GLD_INLINE Vector zero() { return Vector{0, 0, 0, 0}; }
  static GLD_INLINE Vector broadcast(float x) { return Vector{x, x, x, x}; }
  static GLD_INLINE Vector load(const float* p) {
    Vector v;
    __builtin_memcpy(&v, p, sizeof(v));
    return v;
  }
  static GLD_INLINE void store(float* p, Vector v) { __builtin_memcpy(p, &v, sizeof(v)); }
  static GLD_INLINE Vector add(Vector a, Vector b) { return a + b; }
  static GLD_INLINE Vector subtract(Vector a, Vector b) { return a - b; }
  static GLD_INLINE Vector multiply(Vector a, Vector b) { return a * b; }
  static GLD_INLINE Vector divide(Vector a, Vector b) { return a / b; }
  static GLD_INLINE Vector multiply_add(Vector a, Vector b, Vector c) { return a * b + c; }
  static GLD_INLINE Vector accumulate(Vector a, Vector b, Vector sum) { return a * b + sum; }
  static GLD_INLINE Vector maximum(Vector a, Vector b) { return a > b ? a : b; }
  template <int j>
  static GLD_INLINE Vector spread(Vector a) {
    return broadcast(a[j]);
  }
  static GLD_INLINE Vector load_repeated4(const float* p) { return load(p); }
  static GLD_INLINE float sum(Vector a) { return (a[0] + a[2]) + (a[1] + a[3]); }

  // As for AVX2.
  static GLD_INLINE Vector exp2(Vector x) {
    x = x < broadcast(-126.0f) ? broadcast(-126.0f) : x;
    x = x > broadcast(127.0f) ? broadcast(127.0f) : x;
    const Vector shifter = broadcast(12582912.0f);
    const Vector shifted = add(x, shifter);
    const Vector r = subtract(x, subtract(shifted, shifter));
    Vector p = broadcast(0.0001559467758f);
    p = multiply_add(p, r, broadcast(0.001340664391f));
    p = multiply_add(p, r, broadcast(0.009617692975f));
    p = multiply_add(p, r, broadcast(0.05550310551f));
    p = multiply_add(p, r, broadcast(0.2402265278f));
    p = multiply_add(p, r, broadcast(0.693147215f));
    p = multiply_add(p, r, broadcast(1.0f));
    Integers bits, exponent;
    __builtin_memcpy(&bits, &p, sizeof(bits));
    __builtin_memcpy(&exponent, &shifted, sizeof(exponent));
    bits += exponent << 23;
    Vector result;
    __builtin_memcpy(&result, &bits, sizeof(result));
    return result;
  }
};

#endif

using Vector = Simd::Vector;

template <int rows, int vectors>
GLD_INLINE void multiply_step(const float* a, int64_t a_row, const float* b, Vector (&c)[rows][vectors]) {
  Vector operand[vectors];
#pragma GCC unroll 8
  for (int n = 0; n < vectors; ++n) operand[n] = Simd::load(b + n * Simd::lanes);
#pragma GCC unroll 8
  for (int m = 0; m < rows; ++m) {
    const Vector factor = Simd::broadcast(a[m * a_row]);
#pragma GCC unroll 8
    for (int n = 0; n < vectors; ++n) c[m][n] = Simd::accumulate(factor, operand[n], c[m][n]);
  }
}

// Computes c[m][n] += sum over k of a[k * a_step + m * a_row] * b[k * b_step + lanes of n], the one product that
// attention and linear layers are made of. Everything stays in registers: accumulate() names the form of the
// instruction that adds in place, because g++ 12 otherwise moves sums between registers and, with AVX2's sixteen,
// through memory (14 % of the time). There are four steps a turn, because integer additions take slots of the very
// ports that multiply.
template <int rows, int vectors>
GLD_INLINE void multiply_tile(int64_t depth, const float* a, int64_t a_step, int64_t a_row, const float* b,
                              int64_t b_step, Vector (&c)[rows][vectors]) {
  int64_t k = 0;
  for (; k + 4 <= depth; k += 4) {
    multiply_step<rows, vectors>(a, a_row, b, c);
    multiply_step<rows, vectors>(a + a_step, a_row, b + b_step, c);
    multiply_step<rows, vectors>(a + 2 * a_step, a_row, b + 2 * b_step, c);
    multiply_step<rows, vectors>(a + 3 * a_step, a_row, b + 3 * b_step, c);
    a += 4 * a_step;
    b += 4 * b_step;
  }
  for (; k < depth; ++k) {
    multiply_step<rows, vectors>(a, a_row, b, c);
    a += a_step;
    b += b_step;
  }
}

template <int rows, int vectors>
GLD_INLINE void clear_tile(Vector (&c)[rows][vectors]) {
#pragma GCC unroll 8
  for (int m = 0; m < rows; ++m) {
#pragma GCC unroll 8
    for (int n = 0; n < vectors; ++n) c[m][n] = Simd::zero();
  }
}

}  // namespace
}  // namespace gld
