#pragma once

#include "gld/base/options.h"
#include "gld/kernels/attention_kernel.h"
#include "gld/splatting/gaussian_set.h"

#include <cstdint>

namespace gld {

// Learning rates of Adam by kind of parameter; the defaults are 3DGS's.
struct SplatRates : OptionsGroup {
  double mean = 1.6e-4;  // times the scene's extent, falling geometrically ..
  double last_mean = 1.6e-6;
  double log_scale = 0.005;
  double rotation = 0.001;
  double opacity = 0.05;
  double colour = 0.0025;
  double harmonic = 0.0025 / 20;
  double feature = 0.0025;

  void visit(FieldVisitor& visitor) override;
};

struct SplatMoments {
  GaussianSet first, second;
  int64_t steps = 0;
};
SplatMoments splat_moments(const GaussianSet& set);

struct SplatStep {
  double progress = 0;  // of the fit, 0 to 1: where the rate of means stands
  double extent = 1;    // of the scene
};
// Takes one step of Adam with beta .9 and .999 and epsilon 1e-15.
void adam_step(const SplatRates& rates, const SplatStep& step, const GaussianSet& gradients,
               SplatMoments& moments, GaussianSet& set, const KernelSettings& settings);

}  // namespace gld
