#pragma once

// The loops of plane-sweep stereo, compiled once per instruction set (see simd.h). What has no vectors of its own here
// is left to the compiler, which is told to vectorise these files.

#include "gld/kernels/kernel_table.h"
#include "gld/kernels/simd.h"

namespace gld {
namespace {

// Bilinear weights along a row are whole numbers out of this many, so that two products fit 32 bits.
constexpr float kTexelWeights = 16384.0f;
constexpr float kTexelUnit = 1.0f / (16384.0f * static_cast<float>(kTexelOne));

GLD_INLINE void warp_pixels(const WarpedRow& row, int64_t begin, int64_t end) {
  const float right = static_cast<float>(row.from.width - 1),
              bottom = static_cast<float>(row.from.height - 1);
  for (int64_t i = begin; i < end; ++i) {
    const float at = static_cast<float>(i);
    const float z = row.first[2] + at * row.step[2];
    const float inverse = 1.0f / z;
    float x = (row.first[0] + at * row.step[0]) * inverse;
    float y = (row.first[1] + at * row.step[1]) * inverse;
    // What is not a number becomes 0: the border.
    x = x > 0 && z > 0 ? x : 0.0f;
    y = y > 0 ? y : 0.0f;
    x = x < right ? x : right;
    y = y < bottom ? y : bottom;
    const int32_t column = static_cast<int32_t>(x), line = static_cast<int32_t>(y);
    const uint64_t texel = row.from.texels[line * row.from.width + column];
    const int32_t to_right = static_cast<int32_t>((x - static_cast<float>(column)) * kTexelWeights);
    const int32_t to_left = static_cast<int32_t>(kTexelWeights) - to_right;
    const auto corner = [texel](int which) {
      return static_cast<int32_t>(static_cast<int16_t>(texel >> (16 * which)));
    };
    const float upper = static_cast<float>(to_left * corner(0) + to_right * corner(1));
    const float lower = static_cast<float>(to_left * corner(2) + to_right * corner(3));
    const float seen = (texel & 1) != 0 ? 0.0f : 1.0f;
    row.seen[i] = seen;
    row.brightness[i] = (upper + (y - static_cast<float>(line)) * (lower - upper)) * (kTexelUnit * seen);
  }
}

#if defined(__AVX2__)

// Eight pixels are warped with two gathers of four texels; one of 8 x 32 bits would take as long and hold half as much.
void warp_picture_row(const WarpedRow& row) {
  const __m256 lanes = _mm256_setr_ps(0, 1, 2, 3, 4, 5, 6, 7);
  const __m256 zero = _mm256_setzero_ps(), one = _mm256_set1_ps(1);
  const __m256 right = _mm256_set1_ps(static_cast<float>(row.from.width - 1));
  const __m256 bottom = _mm256_set1_ps(static_cast<float>(row.from.height - 1));
  const __m256i width = _mm256_set1_epi32(static_cast<int32_t>(row.from.width));
  const __m256i weights = _mm256_set1_epi32(static_cast<int32_t>(kTexelWeights));
  __m256 first[3], step[3];
  for (int c = 0; c < 3; ++c) {
    first[c] = _mm256_set1_ps(row.first[c]);
    step[c] = _mm256_set1_ps(row.step[c]);
  }
  const auto* texels = reinterpret_cast<const long long*>(row.from.texels);
  int64_t i = 0;
  for (; i + 8 <= row.count; i += 8) {
    const __m256 at = _mm256_add_ps(_mm256_set1_ps(static_cast<float>(i)), lanes);
    const __m256 z = _mm256_fmadd_ps(at, step[2], first[2]);
    const __m256 inverse = _mm256_div_ps(one, z);
    const __m256 in_front = _mm256_cmp_ps(z, zero, _CMP_GT_OQ);
    __m256 x = _mm256_mul_ps(_mm256_fmadd_ps(at, step[0], first[0]), inverse);
    __m256 y = _mm256_mul_ps(_mm256_fmadd_ps(at, step[1], first[1]), inverse);
    // The order of operands makes 0, the border, of what is not a number.
    x = _mm256_min_ps(_mm256_max_ps(_mm256_and_ps(x, in_front), zero), right);
    y = _mm256_min_ps(_mm256_max_ps(y, zero), bottom);
    const __m256i column = _mm256_cvttps_epi32(x), line = _mm256_cvttps_epi32(y);
    const __m256 over = _mm256_sub_ps(x, _mm256_cvtepi32_ps(column));
    const __m256 down = _mm256_sub_ps(y, _mm256_cvtepi32_ps(line));
    const __m256i place = _mm256_add_epi32(_mm256_mullo_epi32(line, width), column);
    // Pixels 0, 1, 4, 5 and 2, 3, 6, 7, so that the shuffles below give them in order.
    const __m256i ordered = _mm256_permute4x64_epi64(place, 0xD8);
    const __m256i a = _mm256_i32gather_epi64(texels, _mm256_castsi256_si128(ordered), 8);
    const __m256i b = _mm256_i32gather_epi64(texels, _mm256_extracti128_si256(ordered, 1), 8);
    const __m256i to_right = _mm256_cvttps_epi32(_mm256_mul_ps(over, _mm256_set1_ps(kTexelWeights)));
    const __m256i to_left = _mm256_sub_epi32(weights, to_right);
    const __m256i pair = _mm256_or_si256(to_left, _mm256_slli_epi32(to_right, 16));
    const __m256i upper_and_lower_a = _mm256_madd_epi16(a, _mm256_unpacklo_epi32(pair, pair));
    const __m256i upper_and_lower_b = _mm256_madd_epi16(b, _mm256_unpackhi_epi32(pair, pair));
    const __m256 float_a = _mm256_castsi256_ps(upper_and_lower_a),
                 float_b = _mm256_castsi256_ps(upper_and_lower_b);
    const __m256 upper = _mm256_cvtepi32_ps(_mm256_castps_si256(_mm256_shuffle_ps(float_a, float_b, 0x88)));
    const __m256 lower = _mm256_cvtepi32_ps(_mm256_castps_si256(_mm256_shuffle_ps(float_a, float_b, 0xDD)));
    const __m256 firsts = _mm256_shuffle_ps(_mm256_castsi256_ps(a), _mm256_castsi256_ps(b), 0x88);
    const __m256 hidden =
        _mm256_castsi256_ps(_mm256_srai_epi32(_mm256_slli_epi32(_mm256_castps_si256(firsts), 31), 31));
    const __m256 value = _mm256_fmadd_ps(down, _mm256_sub_ps(lower, upper), upper);
    _mm256_storeu_ps(row.seen + i, _mm256_andnot_ps(hidden, one));
    _mm256_storeu_ps(row.brightness + i,
                     _mm256_andnot_ps(hidden, _mm256_mul_ps(value, _mm256_set1_ps(kTexelUnit))));
  }
  warp_pixels(row, i, row.count);
}

#else

void warp_picture_row(const WarpedRow& row) { warp_pixels(row, 0, row.count); }

#endif

// The result is accurate to 3e-4 relative; 1 / sqrt(0) may be anything finite or infinite.
GLD_INLINE Vector inverse_square_root(Vector x) {
#if defined(__AVX512F__)
  return _mm512_rsqrt14_ps(x);
#elif defined(__AVX2__)
  return _mm256_rsqrt_ps(x);
#else
  Vector y;
  for (int i = 0; i < Simd::lanes; ++i) y[i] = 1.0f / __builtin_sqrtf(x[i]);
  return y;
#endif
}

template <int radius>
GLD_INLINE Vector window_sum(const float* columns) {
  Vector sum = Simd::load(columns - radius);
#pragma GCC unroll 16
  for (int i = 1 - radius; i <= radius; ++i) sum = Simd::add(sum, Simd::load(columns + i));
  return sum;
}

GLD_INLINE Vector lesser(Vector a, Vector b) {
#if defined(__AVX512F__)
  return _mm512_min_ps(a, b);
#elif defined(__AVX2__)
  return _mm256_min_ps(a, b);
#else
  return a < b ? a : b;
#endif
}

// Stores the whole parts of values from 0 to 255, one byte each.
GLD_INLINE void store_bytes(uint8_t* p, Vector v) {
#if defined(__AVX512F__)
  _mm_storeu_si128(reinterpret_cast<__m128i*>(p), _mm512_cvtepi32_epi8(_mm512_cvttps_epi32(v)));
#elif defined(__AVX2__)
  const __m256i whole = _mm256_cvttps_epi32(v);
  const __m128i words = _mm_packus_epi32(_mm256_castsi256_si128(whole), _mm256_extracti128_si256(whole, 1));
  _mm_storel_epi64(reinterpret_cast<__m128i*>(p), _mm_packus_epi16(words, words));
#else
  for (int i = 0; i < Simd::lanes; ++i) p[i] = static_cast<uint8_t>(static_cast<int32_t>(v[i]));
#endif
}

template <int radius>
void correlate_row_of(const CorrelatedRow& row) {
  const int64_t stride = row.count + 2 * kWindowPadding;
  float* const plain = row.sums + kWindowPadding;
  float* const squares = plain + stride;
  float* const products = squares + stride;
  const auto move_on = [&](int64_t x) {
    const float in = row.entering[x], out = row.leaving[x];
    plain[x] += in - out;
    squares[x] += in * in - out * out;
    products[x] += in * row.entering_reference[x] - out * row.leaving_reference[x];
  };
  int64_t x = 0;
  for (; x + Simd::lanes <= row.count; x += Simd::lanes) {
    const Vector in = Simd::load(row.entering + x), out = Simd::load(row.leaving + x);
    const Vector change = Simd::subtract(in, out);
    Simd::store(plain + x, Simd::add(Simd::load(plain + x), change));
    Simd::store(squares + x, Simd::multiply_add(change, Simd::add(in, out), Simd::load(squares + x)));
    Simd::store(products + x, Simd::subtract(Simd::multiply_add(in, Simd::load(row.entering_reference + x),
                                                                Simd::load(products + x)),
                                             Simd::multiply(out, Simd::load(row.leaving_reference + x))));
  }
  for (; x < row.count; ++x) move_on(x);
  if (row.correlation == nullptr) return;
  const Vector noise = Simd::broadcast(row.noise), one = Simd::broadcast(1.0f);
  const Vector not_seen = Simd::broadcast(kNotSeenCorrelation);
  const auto correlation = [&](const float* share, const float* mean, const float* inverse_deviation,
                               const float* seen, int64_t at) {
    const Vector sum = window_sum<radius>(plain + at);
    const Vector square_sum = window_sum<radius>(squares + at);
    const Vector product_sum = window_sum<radius>(products + at);
    const Vector deviation = Simd::subtract(Simd::add(square_sum, noise),
                                            Simd::multiply(Simd::multiply(sum, sum), Simd::load(share)));
    // Rounding must not make a negative number of it.
    const Vector inverse = inverse_square_root(Simd::maximum(deviation, Simd::broadcast(1e-12f)));
    const Vector covariance = Simd::subtract(product_sum, Simd::multiply(sum, Simd::load(mean)));
    const Vector value = lesser(
        Simd::maximum(Simd::multiply(Simd::multiply(covariance, inverse), Simd::load(inverse_deviation)),
                      Simd::broadcast(-1.0f)),
        one);
    const Vector shown = Simd::load(seen);
    // seen is 0 or 1.
    return Simd::multiply_add(value, shown, Simd::multiply(not_seen, Simd::subtract(one, shown)));
  };
  x = 0;
  for (; x + Simd::lanes <= row.count; x += Simd::lanes) {
    Simd::store(row.correlation + x,
                correlation(row.share + x, row.mean + x, row.inverse_deviation + x, row.seen + x, x));
  }
  if (x == row.count) return;
  float tail[4][Simd::lanes] = {};
  for (int64_t i = 0; x + i < row.count; ++i) {
    tail[0][i] = row.share[x + i];
    tail[1][i] = row.mean[x + i];
    tail[2][i] = row.inverse_deviation[x + i];
    tail[3][i] = row.seen[x + i];
  }
  float result[Simd::lanes];
  Simd::store(result, correlation(tail[0], tail[1], tail[2], tail[3], x));
  for (int64_t i = 0; x + i < row.count; ++i) row.correlation[x + i] = result[i];
}

void correlate_window_row(const CorrelatedRow& row) {
  switch (row.radius) {
    case 1:
      return correlate_row_of<1>(row);
    case 2:
      return correlate_row_of<2>(row);
    case 3:
      return correlate_row_of<3>(row);
    case 4:
      return correlate_row_of<4>(row);
    case 5:
      return correlate_row_of<5>(row);
    case 6:
      return correlate_row_of<6>(row);
    default:
      return correlate_row_of<7>(row);
  }
}

// Returns the cost of some pixels. Where fewer photographs see one, its correlations of those that do not are the
// least, and sort behind the others.
template <int photographs>
GLD_INLINE Vector plane_costs(const float* const* correlations, int64_t x) {
  const Vector not_seen = Simd::broadcast(kNotSeenCorrelation);
  Vector best = Simd::load(correlations[0] + x), next = not_seen, third = not_seen;
#pragma GCC unroll 4
  for (int i = 1; i < photographs; ++i) {
    const Vector value = Simd::load(correlations[i] + x);
    const Vector low = lesser(best, value), lower = lesser(next, low);
    best = Simd::maximum(best, value);
    next = Simd::maximum(next, low);
    third = Simd::maximum(third, lower);
  }
  const Vector zero = Simd::zero(), one = Simd::broadcast(1.0f), half = Simd::broadcast(0.5f);
  // 1 where seen, 0 where kNotSeenCorrelation: correlations are -1 at least.
  const auto seen = [&](Vector value) {
    return lesser(Simd::maximum(Simd::subtract(value, not_seen), zero), one);
  };
  // The better half of three and four are two, of one and two one.
  const Vector share = Simd::multiply(seen(third), half);
  const Vector mean = Simd::multiply_add(Simd::subtract(next, best), share, best);
  const Vector price = Simd::multiply_add(Simd::subtract(one, Simd::maximum(mean, zero)),
                                          Simd::broadcast(static_cast<float>(kDearestMatch)), half);
  return Simd::multiply_add(Simd::subtract(one, seen(best)),
                            Simd::broadcast(static_cast<float>(kUnseenMatch - kDearestMatch)), price);
}

template <int photographs>
void plane_cost_of(const PlaneCostRow& row) {
  int64_t x = 0;
  for (; x + Simd::lanes <= row.count; x += Simd::lanes)
    store_bytes(row.cost + x, plane_costs<photographs>(row.correlations, x));
  if (x == row.count) return;
  float tail[photographs][Simd::lanes] = {};
  const float* tails[photographs];
  for (int i = 0; i < photographs; ++i) {
    tails[i] = tail[i];
    for (int64_t lane = 0; x + lane < row.count; ++lane) tail[i][lane] = row.correlations[i][x + lane];
  }
  uint8_t bytes[Simd::lanes];
  store_bytes(bytes, plane_costs<photographs>(tails, 0));
  for (int64_t lane = 0; x + lane < row.count; ++lane) row.cost[x + lane] = bytes[lane];
}

void plane_cost_of_row(const PlaneCostRow& row) {
  switch (row.photographs) {
    case 1:
      return plane_cost_of<1>(row);
    case 2:
      return plane_cost_of<2>(row);
    case 3:
      return plane_cost_of<3>(row);
    default:
      return plane_cost_of<4>(row);
  }
}

void add_prior_to_costs(const PriorCosts& costs) {
  const float middle = costs.middle, steepness = costs.steepness, dearest = costs.dearest;
  const float* const places = costs.places;
  uint8_t* const cost = costs.cost;
  for (int64_t i = 0; i < costs.planes; ++i) {
    const float off = places[i] - middle;
    const float price = steepness * off * off;
    const float added = price < dearest ? price : dearest;
    cost[i] = static_cast<uint8_t>(cost[i] + static_cast<uint8_t>(static_cast<int32_t>(added)));
  }
}

// Sixteen whole numbers of 16 bits.
#if defined(__AVX2__)

struct Words {
  using Type = __m256i;
  static constexpr int64_t count = 16;
  static GLD_INLINE Type load(const uint16_t* p) {
    return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(p));
  }
  static GLD_INLINE Type load_bytes(const uint8_t* p) {
    return _mm256_cvtepu8_epi16(_mm_loadu_si128(reinterpret_cast<const __m128i*>(p)));
  }
  static GLD_INLINE void store(uint16_t* p, Type v) { _mm256_storeu_si256(reinterpret_cast<__m256i*>(p), v); }
  static GLD_INLINE Type broadcast(uint16_t x) { return _mm256_set1_epi16(static_cast<int16_t>(x)); }
  static GLD_INLINE Type add(Type a, Type b) { return _mm256_add_epi16(a, b); }
  static GLD_INLINE Type subtract(Type a, Type b) { return _mm256_sub_epi16(a, b); }
  static GLD_INLINE Type least(Type a, Type b) { return _mm256_min_epu16(a, b); }
  static GLD_INLINE uint16_t least_of(Type a) {
    const __m128i half = _mm_min_epu16(_mm256_castsi256_si128(a), _mm256_extracti128_si256(a, 1));
    return static_cast<uint16_t>(_mm_extract_epi16(_mm_minpos_epu16(half), 0));
  }
};

#else

struct Words {
  typedef uint16_t Type __attribute__((vector_size(16)));
  typedef uint8_t Bytes __attribute__((vector_size(8)));
  static constexpr int64_t count = 8;
  static GLD_INLINE Type load(const uint16_t* p) {
    Type v;
    __builtin_memcpy(&v, p, sizeof(v));
    return v;
  }
  static GLD_INLINE Type load_bytes(const uint8_t* p) {
    Bytes v;
    __builtin_memcpy(&v, p, sizeof(v));
    return __builtin_convertvector(v, Type);
  }
  static GLD_INLINE void store(uint16_t* p, Type v) { __builtin_memcpy(p, &v, sizeof(v)); }
  static GLD_INLINE Type broadcast(uint16_t x) { return Type{x, x, x, x, x, x, x, x}; }
  static GLD_INLINE Type add(Type a, Type b) { return a + b; }
  static GLD_INLINE Type subtract(Type a, Type b) { return a - b; }
  static GLD_INLINE Type least(Type a, Type b) { return a < b ? a : b; }
  static GLD_INLINE uint16_t least_of(Type a) {
    uint16_t least = a[0];
    for (int i = 1; i < count; ++i) least = a[i] < least ? a[i] : least;
    return least;
  }
};

#endif

void step_paths(PathStep& step) {
  const Words::Type small_step = Words::broadcast(step.small_step);
  Words::Type far[kPathsAPass], before_least[kPathsAPass], after_least[kPathsAPass];
#pragma GCC unroll 4
  for (int64_t path = 0; path < kPathsAPass; ++path) {
    before_least[path] = Words::broadcast(step.least[path]);
    far[path] = Words::broadcast(static_cast<uint16_t>(step.least[path] + step.big_step[path]));
    after_least[path] = Words::broadcast(0xFFFF);
  }
  for (int64_t plane = 0; plane < step.planes; plane += Words::count) {
    const Words::Type cost = Words::load_bytes(step.cost + plane);
    Words::Type sum = step.sum_before == nullptr ? Words::broadcast(0) : Words::load(step.sum_before + plane);
#pragma GCC unroll 4
    for (int64_t path = 0; path < kPathsAPass; ++path) {
      const uint16_t* before = step.before[path] + plane;
      const Words::Type beside =
          Words::add(Words::least(Words::load(before - 1), Words::load(before + 1)), small_step);
      const Words::Type reached = Words::least(Words::least(Words::load(before), beside), far[path]);
      const Words::Type after = Words::add(cost, Words::subtract(reached, before_least[path]));
      Words::store(step.after[path] + plane, after);
      after_least[path] = Words::least(after_least[path], after);
      sum = Words::add(sum, after);
    }
    Words::store(step.sum + plane, sum);
  }
#pragma GCC unroll 4
  for (int64_t path = 0; path < kPathsAPass; ++path) step.least[path] = Words::least_of(after_least[path]);
}

GLD_INLINE uint16_t least_between(const uint16_t* sum, int64_t begin, int64_t end) {
  uint16_t least = 0xFFFF;
  int64_t i = begin;
  if (end - begin >= Words::count) {
    Words::Type least_words = Words::load(sum + i);
    for (i += Words::count; i + Words::count <= end; i += Words::count)
      least_words = Words::least(least_words, Words::load(sum + i));
    least = Words::least_of(least_words);
  }
  for (; i < end; ++i) least = sum[i] < least ? sum[i] : least;
  return least;
}

void find_least_cost(LeastCost& cost) {
  cost.least = least_between(cost.sum, 0, cost.planes);
  cost.plane = 0;
  while (cost.sum[cost.plane] != cost.least) ++cost.plane;
  const int64_t before = cost.plane - cost.apart, behind = cost.plane + cost.apart + 1;
  const uint16_t first = least_between(cost.sum, 0, before > 0 ? before : 0);
  const uint16_t last = least_between(cost.sum, behind < cost.planes ? behind : cost.planes, cost.planes);
  cost.second = first < last ? first : last;
}

}  // namespace
}  // namespace gld
