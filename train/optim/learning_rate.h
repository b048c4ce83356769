#pragma once

#include "gld/base/options.h"

#include <cstdint>

namespace gld {

enum class LearningRateSchedule { kConstant, kLinear, kCosine };

// Learning rate over optimiser steps: a linear warm-up to `peak`, then constant, or a linear or cosine fall
// to `final` at decay_end_step, constant afterwards. decay_start_step keeps the peak until then: a run at a constant
// rate that is continued with a short linear fall behind its last step is worth nearly one that fell all the way.
struct LearningRateOptions : OptionsGroup {
  LearningRateSchedule schedule = LearningRateSchedule::kConstant;
  double peak = 5e-5;
  double final = 5e-5;
  int64_t warmup_steps = 0;
  int64_t decay_start_step = 0;  // 0: the end of the warm-up
  int64_t decay_end_step = 0;    // 0: the run's last step

  void visit(FieldVisitor& visitor) override;
};

// step counts from 0; total_steps is the length of the run.
double learning_rate(const LearningRateOptions& options, int64_t step, int64_t total_steps);

}  // namespace gld
