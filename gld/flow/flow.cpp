#include "gld/flow/flow.h"

#include "gld/base/error.h"

#include <cmath>

#include <torch/types.h>

#include <fmt/format.h>

namespace gld {
namespace {

[[noreturn]] void refuse_time(const char* what, const char* expected, double t) {
  fail({what, expected, fmt::format("t = {}", t), "use the data or the noise itself there"});
}

}  // namespace

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

torch::Tensor velocity_from_data(const torch::Tensor& x, const torch::Tensor& data, double t) {
  if (!(t > 0)) refuse_time("velocity from data", "a flow time above 0", t);
  return (x - data) / t;
}

torch::Tensor velocity_from_noise(const torch::Tensor& x, const torch::Tensor& noise, double t) {
  if (!(t < 1)) refuse_time("velocity from noise", "a flow time below 1", t);
  return (noise - x) / (1.0 - t);
}

torch::Tensor scaled_score_from_velocity(const torch::Tensor& x, const torch::Tensor& velocity, double t) {
  return -noise_from_velocity(x, velocity, t);
}

torch::Tensor score_from_velocity(const torch::Tensor& x, const torch::Tensor& velocity, double t) {
  if (!(t > 0)) refuse_time("score from velocity", "a flow time above 0", t);
  return scaled_score_from_velocity(x, velocity, t) / t;
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
