#include "gld/kernels/adam_kernel.h"

#include <cmath>

namespace gld {

namespace {

template <bool kWithAverage>
void update(const AdamArrays& arrays, const AdamStep& step, int64_t begin, int64_t end) {
  float* const values = arrays.values;
  const float* const gradients = arrays.gradients;
  float* const first = arrays.first_moment;
  float* const second = arrays.second_moment;
  float* const average = arrays.average;
  const float first_rest = 1.0F - step.first_beta;
  const float second_rest = 1.0F - step.second_beta;
  const float average_rest = 1.0F - step.average_decay;
#pragma GCC ivdep
  for (int64_t i = begin; i < end; ++i) {
    const float gradient = gradients[i] * step.gradient_scale + step.coupled_decay * values[i];
    const float m = step.first_beta * first[i] + first_rest * gradient;
    const float v = step.second_beta * second[i] + second_rest * gradient * gradient;
    first[i] = m;
    second[i] = v;
    const float value = values[i] * step.value_scale -
                        step.step_size * m / (std::sqrt(v) * step.inverse_correction + step.epsilon);
    values[i] = value;
    if constexpr (kWithAverage) average[i] = step.average_decay * average[i] + average_rest * value;
  }
}

}  // namespace

void adam_update(const AdamArrays& arrays, const AdamStep& step, int64_t begin, int64_t end) {
  if (arrays.average != nullptr) {
    update<true>(arrays, step, begin, end);
  } else {
    update<false>(arrays, step, begin, end);
  }
}

double sum_of_squares(const float* values, int64_t count) {
  // Four partial sums, so that the additions do not wait for each other.
  double sums[4] = {0.0, 0.0, 0.0, 0.0};
  int64_t i = 0;
  for (; i + 4 <= count; i += 4) {
    for (int64_t lane = 0; lane < 4; ++lane) {
      const double value = values[i + lane];
      sums[lane] += value * value;
    }
  }
  for (; i < count; ++i) sums[0] += static_cast<double>(values[i]) * values[i];
  return (sums[0] + sums[1]) + (sums[2] + sums[3]);
}

}  // namespace gld
