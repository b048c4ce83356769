#pragma once

#include "train/objectives/flow_objective.h"

namespace gld {

// M_L generates level L of all views from noise, given the source views' features and the cameras. What it is trained
// towards are the features of all views encoded together; the source features are those of the source views encoded
// alone, as sampling has them.
class LevelObjective : public FlowObjective {
 public:
  // frozen.statistics are those of that level.
  LevelObjective(const BundleOptions& model, int64_t level, const FlowObjectiveOptions& options,
                 FrozenParts frozen, const ParameterPlacement& placement, int64_t seed);

  std::string kind() const override { return "level"; }

 protected:
  SceneLatents latents(const TrainingScene& scene) const override;
  // The levels that L does not give are left out (zeros), which the decoder knows from its level dropout.
  std::map<int64_t, torch::Tensor> known_levels(const TrainingScene& scene) const override;
};

}  // namespace gld
