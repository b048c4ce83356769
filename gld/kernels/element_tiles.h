#pragma once

// Element-wise passes over rows, and the multiply-add loop that measures the peak, compiled once per
// instruction set (see simd.h).

#include "gld/kernels/kernel_table.h"
#include "gld/kernels/simd.h"

namespace gld {
namespace {

// Returns the square of x / scale, summed in vectors; scale is a power of two.
GLD_INLINE float sum_of_squares(const float* x, int64_t channels, float inverse_scale) {
  Vector partial[4] = {Simd::zero(), Simd::zero(), Simd::zero(), Simd::zero()};
  const Vector factor = Simd::broadcast(inverse_scale);
  int64_t c = 0;
  for (; c + 4 * Simd::lanes <= channels; c += 4 * Simd::lanes) {
#pragma GCC unroll 4
    for (int i = 0; i < 4; ++i) {
      const Vector v = Simd::multiply(Simd::load(x + c + i * Simd::lanes), factor);
      partial[i] = Simd::multiply_add(v, v, partial[i]);
    }
  }
  float sum = Simd::sum(Simd::add(Simd::add(partial[0], partial[1]), Simd::add(partial[2], partial[3])));
  for (; c < channels; ++c) sum += (x[c] * inverse_scale) * (x[c] * inverse_scale);
  return sum;
}

// Returns 1 / sqrt(mean(x^2) + epsilon), also where squares leave the range of float: then the row is summed again,
// divided by the power of two below its largest element.
GLD_INLINE double inverse_rms(const float* x, int64_t channels, double epsilon) {
  const float sum = sum_of_squares(x, channels, 1.0f);
  double mean = static_cast<double>(sum) / static_cast<double>(channels);
  // Squares below 1e-38 lose digits; a sum this large cannot depend on them.
  if (!(sum > 1e-25f && sum < 1e38f)) {
    float largest = 0;
    for (int64_t c = 0; c < channels; ++c) {
      const float magnitude = __builtin_fabsf(x[c]);
      if (magnitude > largest) largest = magnitude;
    }
    if (largest > 0 && largest < __builtin_inff()) {
      int exponent = 0;
      __builtin_frexpf(largest, &exponent);
      // Exponents beyond -126 would make the factor itself overflow.
      exponent = exponent < -126 ? -126 : exponent;
      const double scale = __builtin_ldexp(1.0, exponent);
      const float scaled = sum_of_squares(x, channels, static_cast<float>(1.0 / scale));
      mean = static_cast<double>(scaled) * scale * scale / static_cast<double>(channels);
    }
  }
  return 1.0 / __builtin_sqrt(mean + epsilon);
}

void rms_norm_rows(const RmsNormRows& rows) {
  for (int64_t r = 0; r < rows.rows; ++r) {
    const float* x = rows.x + r * rows.x_stride;
    float* y = rows.y + r * rows.channels;
    const float gain = static_cast<float>(inverse_rms(x, rows.channels, rows.epsilon));
    const int64_t group = rows.rows_per_modulation > 0 ? (rows.first_row + r) / rows.rows_per_modulation : 0;
    const float* scale = rows.scale == nullptr ? nullptr : rows.scale + group * rows.modulation_stride;
    const float* shift = rows.shift == nullptr ? nullptr : rows.shift + group * rows.modulation_stride;
    const Vector gains = Simd::broadcast(gain);
    const Vector one = Simd::broadcast(1.0f);
    int64_t c = 0;
    for (; c + Simd::lanes <= rows.channels; c += Simd::lanes) {
      Vector v = Simd::multiply(Simd::load(x + c), gains);
      if (rows.weight != nullptr) v = Simd::multiply(v, Simd::load(rows.weight + c));
      if (scale != nullptr) v = Simd::multiply(v, Simd::add(one, Simd::load(scale + c)));
      if (shift != nullptr) v = Simd::add(v, Simd::load(shift + c));
      Simd::store(y + c, v);
    }
    for (; c < rows.channels; ++c) {
      float v = x[c] * gain;
      if (rows.weight != nullptr) v *= rows.weight[c];
      if (scale != nullptr) v *= 1.0f + scale[c];
      if (shift != nullptr) v += shift[c];
      y[c] = v;
    }
  }
}

// Returns a b / (1 + 2^(-a log2 e)); a large negative a gives a b / inf, or as good as.
GLD_INLINE Vector silu_times(Vector a, Vector b) {
  const Vector e = Simd::exp2(Simd::multiply(a, Simd::broadcast(-1.44269504f)));
  return Simd::multiply(Simd::divide(a, Simd::add(Simd::broadcast(1.0f), e)), b);
}

void swiglu_rows(const SwigluRows& rows) {
  for (int64_t r = 0; r < rows.rows; ++r) {
    const float* a = rows.a + r * rows.stride;
    const float* b = rows.b + r * rows.stride;
    float* y = rows.y + r * rows.y_stride;
    int64_t c = 0;
    for (; c + Simd::lanes <= rows.channels; c += Simd::lanes) {
      Simd::store(y + c, silu_times(Simd::load(a + c), Simd::load(b + c)));
    }
    if (c < rows.channels) {
      float tail_a[Simd::lanes] = {};
      float tail_b[Simd::lanes] = {};
      for (int64_t i = 0; c + i < rows.channels; ++i) {
        tail_a[i] = a[c + i];
        tail_b[i] = b[c + i];
      }
      float tail_y[Simd::lanes];
      Simd::store(tail_y, silu_times(Simd::load(tail_a), Simd::load(tail_b)));
      for (int64_t i = 0; c + i < rows.channels; ++i) y[c + i] = tail_y[i];
    }
  }
}

void gated_sum_rows(const GatedSumRows& rows) {
  for (int64_t r = 0; r < rows.rows; ++r) {
    const float* x = rows.x + r * rows.channels;
    const float* update = rows.update + r * rows.channels;
    const float* gate = rows.gate + (rows.first_row + r) / rows.rows_per_gate * rows.gate_stride;
    float* y = rows.y + r * rows.channels;
    int64_t c = 0;
    for (; c + Simd::lanes <= rows.channels; c += Simd::lanes) {
      Simd::store(y + c, Simd::multiply_add(Simd::load(gate + c), Simd::load(update + c), Simd::load(x + c)));
    }
    for (; c < rows.channels; ++c) y[c] = x[c] + gate[c] * update[c];
  }
}

double multiply_add_rounds(int64_t rounds) {
  // As many independent chains as hide the latency of two multiply-add units and fit the registers. Every loop over
  // them is unrolled, or the compiler would keep them in memory.
  constexpr int chains = Simd::tile_rows * Simd::tile_vectors;
  Vector c[chains];
#pragma GCC unroll 32
  for (int i = 0; i < chains; ++i) c[i] = Simd::broadcast(static_cast<float>(i));
  Vector factor = Simd::broadcast(0.999f);
  const Vector term = Simd::broadcast(0.001f);
  for (int64_t round = 0; round < rounds; ++round) {
    // The factor is opaque to the optimiser, which could otherwise merge rounds.
    asm volatile("" : "+m"(factor));
    const Vector a = factor;
#pragma GCC unroll 4
    for (int repeat = 0; repeat < 4; ++repeat) {
#pragma GCC unroll 32
      for (int i = 0; i < chains; ++i) c[i] = Simd::multiply_add(c[i], a, term);
    }
  }
  Vector sum = c[0];
#pragma GCC unroll 32
  for (int i = 1; i < chains; ++i) sum = Simd::add(sum, c[i]);
  asm volatile("" : "+m"(sum));
  return static_cast<double>(rounds) * 4 * chains * Simd::lanes * 2;
}

}  // namespace
}  // namespace gld
