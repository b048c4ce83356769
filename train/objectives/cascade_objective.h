#pragma once

#include "train/objectives/flow_objective.h"

namespace gld {

struct CascadeObjectiveOptions : OptionsGroup {
  FlowObjectiveOptions flow;
  double deeper_noise = 0.3;  // tau

  void visit(FieldVisitor& visitor) override;
};

// M_L->0: generates level 0 of all views, given level L of all views, the source views' level 0 and the cameras. In
// training level L comes from the encoder, made noisy as sampling will make it imperfect: (F + sigma e) /
// sqrt(1 + sigma^2) with sigma ~ |N(0, tau^2)| (DESIGN.md section 4, "Cascade training").
class CascadeObjective : public FlowObjective {
 public:
  CascadeObjective(const BundleOptions& model, const CascadeObjectiveOptions& options, FrozenParts frozen,
                   const ParameterPlacement& placement, int64_t seed);

  std::string kind() const override { return "cascade"; }
  void export_model(const std::filesystem::path& folder, DType dtype) const override;

 protected:
  SceneLatents latents(const TrainingScene& scene) const override;
  Prepared prepare(const TrainingScene& scene, const SceneLatents& latents,
                   torch::Generator& generator) const override;
  // Levels L and deeper are those of the true images.
  torch::Tensor decode(const TrainingScene& scene, const torch::Tensor& latent) const override;

 private:
  double deeper_noise_;
};

}  // namespace gld
