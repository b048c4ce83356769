#include "train/optim/learning_rate.h"

#include <algorithm>
#include <cmath>

namespace gld {

void LearningRateOptions::visit(FieldVisitor& visitor) {
  visit_choice(visitor, {"schedule", "course of the learning rate after the warm-up"}, schedule,
               {"constant", "linear", "cosine"});
  visitor.real({"peak", "learning rate after the warm-up"}, peak, {0.0, 10.0});
  visitor.real({"final", "learning rate at the end of a linear or cosine course"}, final, {0.0, 10.0});
  visitor.integer({"warmup_steps", "steps of linear growth at the start"}, warmup_steps, {0, 1'000'000'000});
  visitor.integer(
      {"decay_start_step", "step at which a linear or cosine course leaves the peak; 0 is the warm-up's end"},
      decay_start_step, {0, 1'000'000'000});
  visitor.integer({"decay_end_step", "step at which final is reached; 0 is the end of the run"},
                  decay_end_step, {0, 1'000'000'000});
}

double learning_rate(const LearningRateOptions& options, int64_t step, int64_t total_steps) {
  if (step < options.warmup_steps) {
    return options.peak * static_cast<double>(step + 1) / static_cast<double>(options.warmup_steps);
  }
  if (options.schedule == LearningRateSchedule::kConstant) return options.peak;
  const int64_t end = options.decay_end_step > 0 ? options.decay_end_step : total_steps;
  const int64_t start = std::max(options.warmup_steps, options.decay_start_step);
  if (step < start) return options.peak;
  const int64_t length = std::max<int64_t>(end - start, 1);
  const double progress = std::min(1.0, static_cast<double>(step - start) / static_cast<double>(length));
  const double remaining = options.schedule == LearningRateSchedule::kLinear
                               ? 1.0 - progress
                               : 0.5 * (1.0 + std::cos(M_PI * progress));
  return options.final + (options.peak - options.final) * remaining;
}

}  // namespace gld
