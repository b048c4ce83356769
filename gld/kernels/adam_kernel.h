#pragma once

#include <cstdint>

namespace gld {

// Constants of one Adam step, already combined for the pass over memory.
struct AdamStep {
  float gradient_scale = 1.0F;  // clipping
  float coupled_decay = 0.0F;   // added to the gradient as decay * value (Adam)
  float value_scale = 1.0F;     // 1 - learning rate * decay (AdamW)
  float first_beta = 0.9F;
  float second_beta = 0.95F;
  float step_size = 0.0F;           // learning rate / (1 - first_beta^n)
  float inverse_correction = 1.0F;  // 1 / sqrt(1 - second_beta^n)
  float epsilon = 1e-8F;
  float average_decay = 0.0F;  // of the moving average of the values
};

struct AdamArrays {
  float* values = nullptr;
  const float* gradients = nullptr;
  float* first_moment = nullptr;
  float* second_moment = nullptr;
  float* average = nullptr;  // null without a moving average
};

// Does Adam's update and the moving average of the elements [begin, end) in one pass.
void adam_update(const AdamArrays& arrays, const AdamStep& step, int64_t begin, int64_t end);

// Returns the sum of squares in double.
double sum_of_squares(const float* values, int64_t count);

}  // namespace gld
