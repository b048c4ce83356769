#include "models/refiner/stacked_levels.h"

#include "gld/latents/latent_tokens.h"

namespace gld {

torch::Tensor stacked_levels(const std::vector<torch::Tensor>& levels, const LatentGrid& grid) {
  std::vector<torch::Tensor> maps;
  maps.reserve(levels.size());
  for (const torch::Tensor& level : levels) {
    LatentGrid of_level = grid;
    of_level.views = level.size(0);
    maps.push_back(
        latents_of_tokens(level.slice(1, level.size(1) - grid.tokens_per_view()), of_level, /*patch=*/1));
  }
  return torch::cat(maps, 1);
}

std::vector<torch::Tensor> with_stacked_levels(const std::vector<torch::Tensor>& levels,
                                               const torch::Tensor& maps, int64_t first) {
  std::vector<torch::Tensor> result;
  result.reserve(levels.size());
  int64_t channel = 0;
  for (const torch::Tensor& level : levels) {
    const int64_t channels = level.size(2);
    const auto tokens = tokens_of_latents(maps.slice(1, channel, channel + channels), /*patch=*/1);
    channel += channels;
    result.push_back(level.clone());
    result.back()
        .slice(0, first, first + maps.size(0))
        .slice(1, level.size(1) - tokens.size(1))
        .copy_(tokens);
  }
  return result;
}

}  // namespace gld
