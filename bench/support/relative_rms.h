#pragma once

#include <torch/types.h>

namespace gld {

// Returns the RMS of the difference over the RMS of the reference: the error of latents and velocities in benchmarks.
inline double relative_rms(const torch::Tensor& x, const torch::Tensor& reference) {
  return ((x - reference).norm() / reference.norm()).item<double>();
}

}  // namespace gld
