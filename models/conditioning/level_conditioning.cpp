#include "models/conditioning/level_conditioning.h"

#include <cmath>

namespace gld {

torch::Tensor latent_of_level(const torch::Tensor& raw_level, const LatentGrid& grid,
                              const LevelStatistics& statistics) {
  const int64_t leading = raw_level.size(1) - grid.tokens_per_view();
  return statistics.normalise(generated_tokens(raw_level, leading, statistics.special_tokens));
}

DitSceneInputs condition_on_source_level(const ConditionedGenerator& generator, const Views& views,
                                         const SourceConditioning& sources) {
  const auto level = static_cast<size_t>(generator.level);
  DitSceneInputs inputs;
  inputs.views = views;
  inputs.source_features = latent_of_level(sources.levels.at(level), sources.grid, generator.statistics);
  set_no_warp(inputs, generator.options);
  const WarpedFeatures& warped = sources.warped;
  if (generator.options.warped_sources > 0 && !warped.levels.empty()) {
    inputs.warp_agreement = warped.agreement.narrow(1, 0, generator.options.warped_sources);
    inputs.warped_features = generator.statistics.normalise(warped.levels.at(level));
  }
  return inputs;
}

void condition_on_deeper_level(DitSceneInputs& inputs, const torch::Tensor& deeper_latent) {
  inputs.deeper_level = deeper_latent;
}

torch::Tensor noisy_deeper_level(const torch::Tensor& deeper_latent, const torch::Tensor& noise,
                                 double sigma) {
  return (deeper_latent + sigma * noise) / std::sqrt(1.0 + sigma * sigma);
}

}  // namespace gld
