#include "models/refiner/one_step_update.h"

#include "gld/base/error.h"

#include <cmath>
#include <string>

namespace gld {

double alpha_bar(int64_t timestep) {
  if (timestep < 0 || timestep >= kDiffusionSteps) {
    fail({"timestep", "0 to " + std::to_string(kDiffusionSteps - 1), std::to_string(timestep),
          "choose one of them"});
  }
  const double first = std::sqrt(0.00085), last = std::sqrt(0.012);
  double left = 1;
  for (int64_t step = 0; step <= timestep; ++step) {
    const double root =
        first + (last - first) * static_cast<double>(step) / static_cast<double>(kDiffusionSteps - 1);
    left *= 1 - root * root;
  }
  return left;
}

OneStepGains one_step_gains(int64_t timestep, OneStepForm form) {
  const double signal = alpha_bar(timestep);
  const double noise = std::sqrt((1 - signal) / signal);
  if (form == OneStepForm::kIdentity) return {1, noise};
  return {1 / std::sqrt(signal), -noise};
}

torch::Tensor one_step_update(const torch::Tensor& latent, const torch::Tensor& prediction,
                              const OneStepGains& gains) {
  return gains.latent * latent + gains.prediction * prediction;
}

torch::Tensor noised_latent(const torch::Tensor& latent, const torch::Tensor& noise, int64_t timestep,
                            OneStepForm form) {
  const OneStepGains gains = one_step_gains(timestep, form);
  return (latent + std::abs(gains.prediction) * noise) / gains.latent;
}

}  // namespace gld
