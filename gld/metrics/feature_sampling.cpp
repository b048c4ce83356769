#include "gld/metrics/feature_sampling.h"

#include <torch/nn/functional/vision.h>

namespace gld {

torch::Tensor features_at(const torch::Tensor& features, const torch::Tensor& places) {
  namespace functional = torch::nn::functional;
  const auto map = features.to(torch::kCPU, torch::kFloat64).unsqueeze(0);
  const auto grid = (places.to(torch::kCPU, torch::kFloat64) * 2 - 1).view({1, 1, -1, 2});
  const auto options = functional::GridSampleFuncOptions()
                           .mode(torch::kBilinear)
                           .padding_mode(torch::kBorder)
                           .align_corners(false);
  return functional::grid_sample(map, grid, options).view({features.size(0), -1}).t().contiguous();
}

}  // namespace gld
