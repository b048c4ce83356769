#pragma once

#include "train/objectives/flow_objective.h"

namespace gld {

// M_L: generates level L of all views from noise, given the source views' features and the cameras. What it is
// trained towards are the features of all views encoded together; the source features are those of the source views
// encoded alone, as sampling has them.
class LevelObjective : public FlowObjective {
 public:
  // L is model.boundary_level; frozen.boundary_statistics are those of level L.
  LevelObjective(const BundleOptions& model, const FlowObjectiveOptions& options, FrozenParts frozen,
                 const ParameterPlacement& placement, int64_t seed);

  std::string kind() const override { return "level"; }
  void export_model(const std::filesystem::path& folder, DType dtype) const override;

 protected:
  SceneLatents latents(const TrainingScene& scene) const override;
  Prepared prepare(const TrainingScene& scene, const SceneLatents& latents,
                   torch::Generator& generator) const override;
  // The levels below L are left out (zeros), which the decoder knows from its level dropout.
  torch::Tensor decode(const TrainingScene& scene, const torch::Tensor& latent) const override;
};

}  // namespace gld
