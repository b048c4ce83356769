#include "gld/splatting/splat_adam.h"

#include "gld/kernels/adam_kernel.h"

#include <algorithm>
#include <cmath>

namespace gld {

void SplatRates::visit(FieldVisitor& visitor) {
  const RealRange range{0, 100};
  visitor.real({"mean", "Adam's rate for means, times the scene's extent, at first"}, mean, range);
  visitor.real({"last_mean", "and at last; it falls geometrically"}, last_mean, range);
  visitor.real({"log_scale", "Adam's rate for logarithms of scales"}, log_scale, range);
  visitor.real({"rotation", "Adam's rate for quaternions"}, rotation, range);
  visitor.real({"opacity", "Adam's rate for logits of opacities"}, opacity, range);
  visitor.real({"colour", "Adam's rate for the colours' coefficient 0"}, colour, range);
  visitor.real({"harmonic", "Adam's rate for their other coefficients"}, harmonic, range);
  visitor.real({"feature", "Adam's rate for latents that move geometry"}, feature, range);
}

SplatMoments splat_moments(const GaussianSet& set) {
  return {zero_gaussians_like(set, set.size()), zero_gaussians_like(set, set.size()), 0};
}

void adam_step(const SplatRates& rates, const SplatStep& step, const GaussianSet& gradients,
               SplatMoments& moments, GaussianSet& set, const KernelSettings& settings) {
  constexpr double kFirst = 0.9, kSecond = 0.999;
  ++moments.steps;
  const double of_mean =
      rates.mean > 0 && rates.last_mean > 0
          ? rates.mean * std::pow(rates.last_mean / rates.mean, std::clamp(step.progress, 0.0, 1.0))
          : rates.mean;
  // The rates are in the order of gaussian_arrays.
  const double rate_of[kGaussianArrays] = {of_mean * step.extent, rates.log_scale, rates.rotation,
                                           rates.opacity,         rates.colour,    rates.harmonic,
                                           rates.feature};
  const auto steps = static_cast<double>(moments.steps);
  size_t kind = 0;
  for (const GaussianArray& array : gaussian_arrays(set)) {
    AdamStep adam;
    adam.first_beta = static_cast<float>(kFirst);
    adam.second_beta = static_cast<float>(kSecond);
    adam.step_size = static_cast<float>(rate_of[kind++] / (1 - std::pow(kFirst, steps)));
    adam.inverse_correction = static_cast<float>(1 / std::sqrt(1 - std::pow(kSecond, steps)));
    adam.epsilon = 1e-15F;
    const AdamArrays arrays{(set.*array.values).data(), (gradients.*array.values).data(),
                            (moments.first.*array.values).data(), (moments.second.*array.values).data(),
                            nullptr};
    constexpr int64_t kPart = 1 << 14;
    const auto count = static_cast<int64_t>((set.*array.values).size());
#pragma omp parallel for num_threads(settings.threads) schedule(static)
    for (int64_t begin = 0; begin < count; begin += kPart)
      adam_update(arrays, adam, begin, std::min(begin + kPart, count));
  }
}

}  // namespace gld
