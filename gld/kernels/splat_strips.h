#pragma once

// The loops of splatting: weights of Gaussians along strips of pixels, their channels, and both backward. The
// mathematics is in gld/splatting/compositing.h.

#include "gld/kernels/kernel_table.h"
#include "gld/kernels/simd.h"

#include <type_traits>

namespace gld {
namespace {

constexpr int kSplatChannelBlock = 8;

// Returns one where a >= b, elsewhere the other.
GLD_INLINE Vector where_at_least(Vector a, Vector b, Vector one, Vector other) {
#if defined(__AVX512F__)
  return _mm512_mask_blend_ps(_mm512_cmp_ps_mask(a, b, _CMP_GE_OQ), other, one);
#elif defined(__AVX2__)
  return _mm256_blendv_ps(other, one, _mm256_cmp_ps(a, b, _CMP_GE_OQ));
#else
  return a >= b ? one : other;
#endif
}

GLD_INLINE bool any_below(Vector a, float bound) {
#if defined(__AVX512F__)
  return _mm512_cmp_ps_mask(a, _mm512_set1_ps(bound), _CMP_LT_OQ) != 0;
#elif defined(__AVX2__)
  return _mm256_movemask_ps(_mm256_cmp_ps(a, _mm256_set1_ps(bound), _CMP_LT_OQ)) != 0;
#else
  for (int i = 0; i < Simd::lanes; ++i) {
    if (a[i] < bound) return true;
  }
  return false;
#endif
}

GLD_INLINE Vector lane_numbers() {
  float numbers[Simd::lanes];
  for (int i = 0; i < Simd::lanes; ++i) numbers[i] = static_cast<float>(i);
  return Simd::load(numbers);
}

int64_t weigh_splats(const SplatWeights& strip) {
  const Vector lane = lane_numbers(), one = Simd::broadcast(1.0f), zero = Simd::zero();
  const Vector least_alpha_power = Simd::broadcast(strip.least_alpha_power),
               dense = Simd::broadcast(kDensestAlpha);
  // A pixel that is done has a stop that nothing reaches.
  constexpr float kNever = 2.0f;
  Vector left = one, stop = Simd::broadcast(strip.least_transmittance);
  int64_t i = 0;
  for (; i < strip.count; ++i) {
    const SplatRow& row = strip.rows[strip.records[i]];
    const Vector along = Simd::multiply_add(Simd::broadcast(row.slope), lane, Simd::broadcast(row.shift));
    const Vector power = Simd::subtract(Simd::broadcast(row.height), Simd::multiply(along, along));
    const Vector value = Simd::exp2(power);
    // There cannot be NaN: rows are finite.
    const Vector there = where_at_least(power, least_alpha_power, value, zero);
    const Vector alpha = where_at_least(there, dense, dense, there);
    const Vector after = Simd::subtract(left, Simd::multiply(left, alpha));
    Simd::store(strip.alpha + i * Simd::lanes, where_at_least(after, stop, there, zero));
    Simd::store(strip.weight + i * Simd::lanes,
                where_at_least(after, stop, Simd::multiply(left, alpha), zero));
    const Vector still = where_at_least(after, stop, stop, Simd::broadcast(kNever));
    left = where_at_least(after, stop, after, left);
    stop = still;
    if (!any_below(stop, 1.0f)) {
      ++i;
      break;
    }
  }
  Simd::store(strip.transmittance, left);
  return i;
}

template <int channels>
void sum_splat_channels(const SplatChannels& strip, int64_t first) {
  Vector sum[channels];
  const Vector left = Simd::load(strip.transmittance);
#pragma GCC unroll 8
  for (int c = 0; c < channels; ++c) sum[c] = Simd::zero();
  for (int64_t i = 0; i < strip.count; ++i) {
    const Vector weight = Simd::load(strip.weight + i * Simd::lanes);
    const float* features = strip.features + strip.gaussians[i] * strip.channels + first;
#pragma GCC unroll 8
    for (int c = 0; c < channels; ++c)
      sum[c] = Simd::accumulate(weight, Simd::broadcast(features[c]), sum[c]);
  }
#pragma GCC unroll 8
  for (int c = 0; c < channels; ++c) {
    if (strip.background != nullptr)
      sum[c] = Simd::accumulate(left, Simd::broadcast(strip.background[first + c]), sum[c]);
    Simd::store(strip.image + (first + c) * strip.plane, sum[c]);
  }
}

// Computes q_i += f_i . g over some channels.
template <int channels>
void project_splat_channels(const SplatSlopes& strip, int64_t first) {
  Vector gradient[channels];
#pragma GCC unroll 8
  for (int c = 0; c < channels; ++c) gradient[c] = Simd::load(strip.gradient + (first + c) * strip.plane);
  for (int64_t i = 0; i < strip.used; ++i) {
    const float* features = strip.features + strip.gaussians[i] * strip.channels + first;
    float* const place = strip.scratch + i * Simd::lanes;
    Vector q = first == 0 ? Simd::zero() : Simd::load(place);
#pragma GCC unroll 8
    for (int c = 0; c < channels; ++c) q = Simd::accumulate(gradient[c], Simd::broadcast(features[c]), q);
    Simd::store(place, q);
  }
}

template <int channels>
void sum_splat_feature_gradients(const SplatSums& tile, int64_t first) {
  for (int64_t j = 0; j < tile.count; ++j) {
    Vector sum[channels];
#pragma GCC unroll 8
    for (int c = 0; c < channels; ++c) sum[c] = Simd::zero();
    for (int64_t r = tile.first_record[j]; r < tile.first_record[j + 1]; ++r) {
      const Vector weight = Simd::load(tile.weight + r * Simd::lanes);
      const float* gradient = tile.gradient + tile.pixel[r] + first * tile.plane;
#pragma GCC unroll 8
      for (int c = 0; c < channels; ++c)
        sum[c] = Simd::accumulate(weight, Simd::load(gradient + c * tile.plane), sum[c]);
    }
#pragma GCC unroll 8
    for (int c = 0; c < channels; ++c) tile.features[j * tile.channels + first + c] = Simd::sum(sum[c]);
  }
}

// Calls run(number of channels, the first) for blocks of up to eight of count channels; the number is known when this
// is compiled.
template <typename Run>
void for_channel_blocks(int64_t count, const Run& run) {
  static_assert(kSplatChannelBlock == 8);
  for (int64_t first = 0; first < count; first += kSplatChannelBlock) {
    const int64_t left = count - first;
    switch (left < kSplatChannelBlock ? left : kSplatChannelBlock) {
      case 1:
        run(std::integral_constant<int, 1>(), first);
        break;
      case 2:
        run(std::integral_constant<int, 2>(), first);
        break;
      case 3:
        run(std::integral_constant<int, 3>(), first);
        break;
      case 4:
        run(std::integral_constant<int, 4>(), first);
        break;
      case 5:
        run(std::integral_constant<int, 5>(), first);
        break;
      case 6:
        run(std::integral_constant<int, 6>(), first);
        break;
      case 7:
        run(std::integral_constant<int, 7>(), first);
        break;
      default:
        run(std::integral_constant<int, 8>(), first);
    }
  }
}

void composite_splat_channels(const SplatChannels& strip) {
  for_channel_blocks(strip.channels,
                     [&](auto channels, int64_t first) { sum_splat_channels<channels>(strip, first); });
}

void splat_slopes_of_strip(const SplatSlopes& strip) {
  if (strip.slope != nullptr) {
    for_channel_blocks(strip.channels,
                       [&](auto channels, int64_t first) { project_splat_channels<channels>(strip, first); });
  }
  const Vector one = Simd::broadcast(1.0f), zero = Simd::zero(), dense = Simd::broadcast(kDensestAlpha);
  Vector behind = zero;
  if (strip.background != nullptr) {
    for (int64_t c = 0; c < strip.channels; ++c) {
      behind = Simd::multiply_add(Simd::broadcast(strip.background[c]),
                                  Simd::load(strip.gradient + c * strip.plane), behind);
    }
    behind = Simd::multiply(behind, Simd::load(strip.transmittance));
  }
  for (int64_t i = strip.count - 1; i >= strip.used; --i) {
    Simd::store(strip.record_weight + strip.records[i] * Simd::lanes, zero);
    if (strip.slope != nullptr) Simd::store(strip.slope + strip.records[i] * Simd::lanes, zero);
  }
  for (int64_t i = strip.used - 1; i >= 0; --i) {
    const Vector weight = Simd::load(strip.weight + i * Simd::lanes);
    Simd::store(strip.record_weight + strip.records[i] * Simd::lanes, weight);
    if (strip.slope == nullptr) continue;
    const Vector value = Simd::load(strip.alpha + i * Simd::lanes);
    const Vector alpha = where_at_least(value, dense, dense, value);
    const Vector seen = Simd::multiply(weight, Simd::load(strip.scratch + i * Simd::lanes));
    // alpha dalpha = alpha T q - S alpha / (1 - alpha), and alpha T is the weight.
    const Vector share = Simd::divide(alpha, Simd::subtract(one, alpha));
    const Vector slope = Simd::subtract(seen, Simd::multiply(behind, share));
    // d value / d what it depends on is the value itself, not what alpha is held at.
    const Vector of_held = strip.held == HeldAlphaGradient::kPublished
                               ? Simd::multiply(slope, Simd::divide(value, dense))
                               : zero;
    Simd::store(strip.slope + strip.records[i] * Simd::lanes, where_at_least(value, dense, of_held, slope));
    behind = Simd::add(behind, seen);
  }
}

void sum_splat_gradients(const SplatSums& tile) {
  for_channel_blocks(tile.channels, [&](auto channels, int64_t first) {
    sum_splat_feature_gradients<channels>(tile, first);
  });
  if (tile.slope == nullptr) return;
  const Vector lane = lane_numbers();
  for (int64_t j = 0; j < tile.count; ++j) {
    Vector sum[kSplatMoments];
#pragma GCC unroll 8
    for (int k = 0; k < kSplatMoments; ++k) sum[k] = Simd::zero();
    for (int64_t r = tile.first_record[j]; r < tile.first_record[j + 1]; ++r) {
      const SplatRow& row = tile.rows[r];
      const Vector along = Simd::multiply_add(Simd::broadcast(row.slope), lane, Simd::broadcast(row.shift));
      const Vector across = Simd::broadcast(row.across);
      const Vector slope = Simd::load(tile.slope + r * Simd::lanes);
      const Vector first_along = Simd::multiply(slope, along), first_across = Simd::multiply(slope, across);
      sum[0] = Simd::add(sum[0], slope);
      sum[1] = Simd::add(sum[1], first_along);
      sum[2] = Simd::add(sum[2], first_across);
      sum[3] = Simd::accumulate(first_along, along, sum[3]);
      sum[4] = Simd::accumulate(first_along, across, sum[4]);
      sum[5] = Simd::accumulate(first_across, across, sum[5]);
    }
#pragma GCC unroll 8
    for (int k = 0; k < kSplatMoments; ++k) tile.moments[j * kSplatMoments + k] = Simd::sum(sum[k]);
  }
}

void sum_weighted_rows(const WeightedRows& rows) {
  int64_t x = 0;
  for (; x + 2 * Simd::lanes <= rows.count; x += 2 * Simd::lanes) {
    Vector a = Simd::zero(), b = a;
#pragma GCC unroll 11
    for (int64_t k = 0; k < kWeightedRows; ++k) {
      const Vector weight = Simd::broadcast(rows.weights[k]);
      a = Simd::accumulate(weight, Simd::load(rows.rows[k] + x), a);
      b = Simd::accumulate(weight, Simd::load(rows.rows[k] + x + Simd::lanes), b);
    }
    Simd::store(rows.sum + x, a);
    Simd::store(rows.sum + x + Simd::lanes, b);
  }
  for (; x < rows.count; ++x) {
    float sum = 0;
    for (int64_t k = 0; k < kWeightedRows; ++k) sum += rows.weights[k] * rows.rows[k][x];
    rows.sum[x] = sum;
  }
}

}  // namespace
}  // namespace gld
