#pragma once

#include "train/objectives/flow_objective.h"

namespace gld {

struct CascadeObjectiveOptions : OptionsGroup {
  FlowObjectiveOptions flow;
  double deeper_noise = 0.3;  // tau

  void visit(FieldVisitor& visitor) override;
};

// M_L->l generates level l of all views, given the deeper level L of all views, the source views' level l and the
// cameras; the published one is 1 -> 0. In training level L comes from the encoder, made noisy as sampling will make it
// imperfect: (F + sigma e) / sqrt(1 + sigma^2) with sigma ~ |N(0, tau^2)| (DESIGN.md section 4, "Cascade training").
class CascadeObjective : public FlowObjective {
 public:
  CascadeObjective(const BundleOptions& model, const LevelGenerator& cascade,
                   const CascadeObjectiveOptions& options, FrozenParts frozen,
                   const ParameterPlacement& placement, int64_t seed);

  std::string kind() const override { return "cascade"; }

 protected:
  SceneLatents latents(const TrainingScene& scene) const override;
  // Returns them with noise on the deeper level.
  SceneLatents drawn(const SceneLatents& latents, torch::Generator& generator) const override;
  // The other levels are those of the true images.
  std::map<int64_t, torch::Tensor> known_levels(const TrainingScene& scene) const override;

 private:
  double deeper_noise_;
};

}  // namespace gld
