#include "train/objectives/cascade_objective.h"

#include "models/conditioning/level_conditioning.h"

#include <cmath>

#include <torch/autograd.h>

namespace gld {

void CascadeObjectiveOptions::visit(FieldVisitor& visitor) {
  visitor.group({"flow", "flow matching"}, flow);
  visitor.real({"deeper_noise", "tau of the noise on the deeper level, in deviations of a channel"},
               deeper_noise, {0.0, 100.0});
}

CascadeObjective::CascadeObjective(const BundleOptions& model, const LevelGenerator& cascade,
                                   const CascadeObjectiveOptions& options, FrozenParts frozen,
                                   const ParameterPlacement& placement, int64_t seed)
    : FlowObjective(model, cascade, options.flow, std::move(frozen), placement, seed),
      deeper_noise_(options.deeper_noise) {}

SceneLatents CascadeObjective::latents(const TrainingScene& scene) const {
  SceneLatents latents;
  latents.shown = conditioned_on_sources(scene);
  latents.clean = latent_of(scene, generator().level, frozen().statistics);
  condition_on_deeper_level(latents.shown, latent_of(scene, *generator().deeper, frozen().deeper_statistics));
  return latents;
}

SceneLatents CascadeObjective::drawn(const SceneLatents& latents, torch::Generator& generator) const {
  SceneLatents prepared = latents;
  const auto& deeper = latents.shown.deeper_level;
  const double sigma = deeper_noise_ * std::abs(torch::randn({1}, generator, torch::kFloat64).item<double>());
  const auto noise = torch::randn(deeper.sizes(), generator, torch::kFloat32).to(deeper.device());
  condition_on_deeper_level(prepared.shown, noisy_deeper_level(deeper, noise, sigma));
  return prepared;
}

std::map<int64_t, torch::Tensor> CascadeObjective::known_levels(const TrainingScene& scene) const {
  // The true levels, so that the picture shows what the generated one is worth.
  const torch::NoGradGuard no_grad;
  const auto encoded = frozen().space->encode(images_of(scene, scene.views.size()), model().boundary_level);
  std::map<int64_t, torch::Tensor> levels;
  for (size_t level = 0; level < encoded.size(); ++level)
    levels[static_cast<int64_t>(level)] = encoded[level];
  return levels;
}

}  // namespace gld
