#include "infer/evaluate/latent_comparison.h"

#include "models/conditioning/level_conditioning.h"

namespace gld {

LevelLatents latents_of_levels(const PipelineModels& models, const std::vector<torch::Tensor>& raw,
                               const LatentGrid& grid) {
  const auto& generators = models.levels.generators;
  LevelLatents latents;
  for (size_t i = 0; i < generators.size(); ++i) {
    const int64_t level = generators[i].level;
    latents[level] = latent_of_level(raw.at(static_cast<size_t>(level)), grid, models.statistics[i]);
  }
  return latents;
}

LevelLatents maps_of_targets(const LevelLatents& latents, const LatentGrid& grid, const Views& views) {
  LevelLatents maps;
  for (const auto& [level, tokens] : latents) {
    const int64_t patches = grid.tokens_per_view();
    const auto of_patches = tokens.narrow(1, tokens.size(1) - patches, patches);
    maps[level] = token_maps(of_patches, grid).narrow(0, views.num_sources, views.num_targets());
  }
  return maps;
}

}  // namespace gld
