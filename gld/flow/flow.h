#pragma once

#include "gld/cameras/camera.h"

#include <torch/types.h>

namespace gld {

// The linear path between data (t = 0) and noise (t = 1) (DESIGN.md section 4, "Flow"; Lipman et al. 2023, Liu et al.
// 2023). Shapes are any; the time shift is shifted_time of gld/flow/schedule.h.

// x_t = (1 - t) data + t noise.
torch::Tensor interpolate(const torch::Tensor& data, const torch::Tensor& noise, double t);
// v = noise - data.
torch::Tensor velocity_target(const torch::Tensor& data, const torch::Tensor& noise);

// What a velocity v at (x, t) predicts: data = x - t v, noise = x + (1 - t) v. Exact at both ends.
torch::Tensor data_from_velocity(const torch::Tensor& x, const torch::Tensor& velocity, double t);
torch::Tensor noise_from_velocity(const torch::Tensor& x, const torch::Tensor& velocity, double t);

// Returns t times the score, t grad log p_t(x) = -noise, which stays finite as t goes to 0, where the score itself does
// not exist for data on a point.
torch::Tensor scaled_score_from_velocity(const torch::Tensor& x, const torch::Tensor& velocity, double t);

// Returns the paper's time shift for a latent of d = channels * tokens of all views numbers, sqrt(d / 4096) (Esser et
// al. 2024): 62.4 for DA3-Base at 504 x 504 with 8 views.
double time_shift_of(const LatentGrid& grid, int64_t channels);
// Returns the shift that a model was given, or, where that is 0, time_shift_of its latent.
double resolved_time_shift(double given, const LatentGrid& grid, int64_t channels);

}  // namespace gld
