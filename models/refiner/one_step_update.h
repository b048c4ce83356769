#pragma once

#include "models/refiner/refiner_options.h"

#include <cstdint>

#include <torch/types.h>

namespace gld {

constexpr int64_t kDiffusionSteps = 1000;

// Returns what is left of a latent's signal, as a variance, after `timestep` of the scaled linear schedule of Stable
// Diffusion: the product of 1 - beta_i over i <= timestep, sqrt(beta_i) even from sqrt(.00085) to sqrt(.012) over 1000
// steps. timestep is 0 to 999.
double alpha_bar(int64_t timestep);

// z_out = latent * z + prediction * e, e what the network gives for z.
struct OneStepGains {
  double latent = 1;
  double prediction = 0;
};
OneStepGains one_step_gains(int64_t timestep, OneStepForm form);

torch::Tensor one_step_update(const torch::Tensor& latent, const torch::Tensor& prediction,
                              const OneStepGains& gains);

// Returns the latent with noise of that timestep, as the network sees it: one step of a network that sees through the
// noise gives the latent back. noise is normal, of the latent's shape.
torch::Tensor noised_latent(const torch::Tensor& latent, const torch::Tensor& noise, int64_t timestep,
                            OneStepForm form);

}  // namespace gld
