#include "train/objectives/level_objective.h"

#include <torch/autograd.h>

namespace gld {

LevelObjective::LevelObjective(const BundleOptions& model, const FlowObjectiveOptions& options,
                               FrozenParts frozen, const ParameterPlacement& placement, int64_t seed)
    : FlowObjective(model, model.level1, model.level1_time_shift.training, options, std::move(frozen),
                    placement, seed) {}

SceneLatents LevelObjective::latents(const TrainingScene& scene) const {
  const int64_t level = model().boundary_level;
  const auto index = static_cast<size_t>(level);
  const auto& statistics = frozen().boundary_statistics;
  SceneLatents latents;
  latents.sources = statistics.normalise(patches_of(encode(scene, scene.views.num_sources, level)[index]));
  latents.clean = statistics.normalise(patches_of(encode(scene, scene.views.size(), level)[index]));
  return latents;
}

FlowObjective::Prepared LevelObjective::prepare(const TrainingScene& scene, const SceneLatents& latents,
                                                torch::Generator& /*generator*/) const {
  Prepared prepared;
  prepared.inputs.views = scene.views;
  prepared.inputs.source_features = latents.sources;
  prepared.clean = latents.clean;
  return prepared;
}

torch::Tensor LevelObjective::decode(const TrainingScene& scene, const torch::Tensor& latent) const {
  const int64_t level = model().boundary_level;
  const auto class_token = encode(scene, 1, level)[static_cast<size_t>(level)].narrow(1, 0, 1);
  PropagationStart start;
  start.level = level;
  start.tokens = torch::cat({class_token.expand({latent.size(0), 1, latent.size(2)}),
                             frozen().boundary_statistics.denormalise(latent)},
                            1);
  start.grid = grid_of(scene);
  std::vector<torch::Tensor> levels(static_cast<size_t>(level), torch::zeros_like(latent));
  for (const auto& propagated : frozen().backbone->propagate(start)) levels.push_back(propagated.patches);
  return frozen().rgb_decoder->decode(torch::cat(levels, 2), grid_of(scene));
}

void LevelObjective::export_model(const std::filesystem::path& folder, DType dtype) const {
  save_bundle_options(folder, model());
  save_bundle_part(folder, BundlePart::kLevel1, named_tensors(dit()), dtype);
}

}  // namespace gld
