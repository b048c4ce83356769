#include "train/objectives/cascade_objective.h"

#include <cmath>

#include <torch/autograd.h>

namespace gld {

void CascadeObjectiveOptions::visit(FieldVisitor& visitor) {
  visitor.group({"flow", "flow matching"}, flow);
  visitor.real({"deeper_noise", "tau of the noise on the deeper level, in deviations of a channel"},
               deeper_noise, {0.0, 100.0});
}

CascadeObjective::CascadeObjective(const BundleOptions& model, const CascadeObjectiveOptions& options,
                                   FrozenParts frozen, const ParameterPlacement& placement, int64_t seed)
    : FlowObjective(model, model.cascade, model.cascade_time_shift.training, options.flow, std::move(frozen),
                    placement, seed),
      deeper_noise_(options.deeper_noise) {}

SceneLatents CascadeObjective::latents(const TrainingScene& scene) const {
  const int64_t boundary = model().boundary_level;
  const auto levels = encode(scene, scene.views.size(), boundary);
  const auto& statistics = frozen().level0_statistics;
  SceneLatents latents;
  latents.sources = statistics.normalise(patches_of(encode(scene, scene.views.num_sources, 0)[0]));
  latents.clean = statistics.normalise(patches_of(levels[0]));
  latents.deeper = frozen().boundary_statistics.normalise(patches_of(levels[static_cast<size_t>(boundary)]));
  return latents;
}

FlowObjective::Prepared CascadeObjective::prepare(const TrainingScene& scene, const SceneLatents& latents,
                                                  torch::Generator& generator) const {
  Prepared prepared;
  prepared.inputs.views = scene.views;
  prepared.inputs.source_features = latents.sources;
  prepared.clean = latents.clean;
  const auto& deeper = latents.deeper;
  const double strength =
      deeper_noise_ * std::abs(torch::randn({1}, generator, torch::kFloat64).item<double>());
  const auto noise = torch::randn(deeper.sizes(), generator, torch::kFloat32).to(deeper.device());
  prepared.inputs.deeper_level = (deeper + strength * noise) / std::sqrt(1.0 + strength * strength);
  return prepared;
}

torch::Tensor CascadeObjective::decode(const TrainingScene& scene, const torch::Tensor& latent) const {
  const auto raw = encode(scene, scene.views.size(), model().backbone.levels() - 1);
  std::vector<torch::Tensor> levels = {
      frozen().backbone->normalise_for_decoding(frozen().level0_statistics.denormalise(latent))};
  for (size_t level = 1; level < raw.size(); ++level) {
    levels.push_back(frozen().backbone->decodable(raw[level]).patches);
  }
  return frozen().rgb_decoder->decode(torch::cat(levels, 2), grid_of(scene));
}

void CascadeObjective::export_model(const std::filesystem::path& folder, DType dtype) const {
  save_bundle_options(folder, model());
  save_bundle_part(folder, BundlePart::kCascade, named_tensors(dit()), dtype);
}

}  // namespace gld
