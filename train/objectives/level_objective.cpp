#include "train/objectives/level_objective.h"

#include <utility>

namespace gld {

LevelObjective::LevelObjective(const BundleOptions& model, int64_t level, const FlowObjectiveOptions& options,
                               FrozenParts frozen, const ParameterPlacement& placement, int64_t seed)
    : FlowObjective(model, level_model(level), options, std::move(frozen), placement, seed) {}

SceneLatents LevelObjective::latents(const TrainingScene& scene) const {
  SceneLatents latents;
  latents.shown = conditioned_on_sources(scene);
  latents.clean = latent_of(scene, generator().level, frozen().statistics);
  return latents;
}

std::map<int64_t, torch::Tensor> LevelObjective::known_levels(const TrainingScene& /*scene*/) const {
  return {};
}

}  // namespace gld
