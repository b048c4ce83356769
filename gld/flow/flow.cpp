#include "gld/flow/flow.h"

#include <cmath>

#include <torch/types.h>

namespace gld {

torch::Tensor interpolate(const torch::Tensor& data, const torch::Tensor& noise, double t) {
  return (1.0 - t) * data + t * noise;
}

torch::Tensor velocity_target(const torch::Tensor& data, const torch::Tensor& noise) { return noise - data; }

torch::Tensor data_from_velocity(const torch::Tensor& x, const torch::Tensor& velocity, double t) {
  return x - t * velocity;
}

torch::Tensor noise_from_velocity(const torch::Tensor& x, const torch::Tensor& velocity, double t) {
  return x + (1.0 - t) * velocity;
}

torch::Tensor scaled_score_from_velocity(const torch::Tensor& x, const torch::Tensor& velocity, double t) {
  return -noise_from_velocity(x, velocity, t);
}

double time_shift_of(const LatentGrid& grid, int64_t channels) {
  constexpr double kReferenceSize = 4096;
  const auto size = static_cast<double>(channels * grid.views * grid.tokens_per_view());
  return std::sqrt(size / kReferenceSize);
}

double resolved_time_shift(double given, const LatentGrid& grid, int64_t channels) {
  return given == 0 ? time_shift_of(grid, channels) : given;
}

}  // namespace gld
