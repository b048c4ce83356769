#pragma once

#include <vector>

#include <ATen/core/Generator.h>
#include <torch/types.h>

namespace gld {

// Prepares a part that reads features for generated ones, which are never exact (Zheng et al. 2025, RAE, section 4.3):
// adds noise of random strength |N(0, deviation^2)|, one for all levels of a scene, in units of each channel's
// deviation over the scene. levels are (views, tokens, channels) each; nothing is drawn where deviation is 0. The noise
// is drawn on the CPU.
std::vector<torch::Tensor> with_feature_noise(std::vector<torch::Tensor> levels, double deviation,
                                              torch::Generator& generator);

}  // namespace gld
