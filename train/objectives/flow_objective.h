#pragma once

#include "gld/latents/level_statistics.h"
#include "models/bundle/bundle.h"
#include "models/dit/flow_matching_loss.h"
#include "train/loop/objective.h"
#include "train/objectives/correspondence.h"
#include "train/objectives/frozen_parts.h"
#include "train/objectives/scene_latents.h"

#include <cstdint>
#include <map>
#include <memory>
#include <vector>

#include <torch/types.h>

namespace gld {

struct FlowObjectiveOptions : OptionsGroup {
  ModelStart start = ModelStart::kRandom;
  CarryingDepth carried_by = CarryingDepth::kHead;  // for models with warped_sources
  double camera_dropout = 0.1;
  double carried_dropout = 0;  // for models with warped_sources
  int64_t validation_evaluations = 8;
  bool checkpoint_blocks = false;
  double correspondence_weight = 0;
  std::vector<int64_t> correspondence_blocks;  // counted from 0, the condition encoder's first
  double kept_latents_gib = 0;                 // of scenes seen before; 0 encodes every time

  void visit(FieldVisitor& visitor) override;
};

// Flow matching of the joint latent of all views (DESIGN.md section 4, "Flow"): one flow time a scene, uniform and
// then shifted; x_t = (1 - t) x_data + t noise for all views; mean squared error of the velocity noise - x_data over
// all views, with the parts of source and target views logged apart. With probability camera_dropout a scene is
// shown without cameras, as the unconditional branch of guidance sees it. With probability carried_dropout
// nothing is carried into its target views, as where no photograph tells the unit of depth: what never learnt to
// do without samples noise there (docs/HISTORY.md, "Nothing carried"). Validation then has the loss of that too.
//
// With correspondence_weight (scenes with depth) the attention of correspondence_blocks is taught in which tokens of
// the source views the surface of each token is seen (train/objectives/correspondence.h): novel views are made by
// fetching it there, and by the flow's loss alone attention finds that out late.
class FlowObjective : public Objective {
 public:
  torch::Device device() const override { return placement_.device; }
  // Recomputed activations write gradients where the parameters are.
  bool concurrent() const override { return !options_.checkpoint_blocks; }
  int64_t learn_in(ComputePrecision precision) override;
  std::vector<NamedParameter> parameters() const override;
  std::vector<NamedParameter> untrained() const override;
  // Keeps what the frozen networks make of scenes in that folder too.
  void keep_in(std::shared_ptr<const KeptFolder> folder) { kept_latents_.keep_in(std::move(folder)); }
  // Takes over the weights of a trained model of the same architecture.
  void start_from(const DitDh& trained);
  Losses losses(const TrainingBatch& batch, const StepContext& context) override;
  Validation validate(const std::vector<TrainingScene>& scenes) override;

 protected:
  // Returns what the model is shown of a scene, and what it has to generate: as the frozen backbone makes it.
  virtual SceneLatents latents(const TrainingScene& scene) const = 0;

  // Makes the objective of the part of the model that this generator is.
  FlowObjective(const BundleOptions& model, const LevelGenerator& generator,
                const FlowObjectiveOptions& options, FrozenParts frozen, const ParameterPlacement& placement,
                int64_t seed);

  // Returns the same with what is drawn anew each time that a scene is shown. generator gives random numbers that
  // belong to the training of this scene.
  virtual SceneLatents drawn(const SceneLatents& latents, torch::Generator& generator) const;
  // Returns the levels, raw, that a validation picture takes beside the generated one: of all views, or none to see
  // what the generated level is worth alone.
  virtual std::map<int64_t, torch::Tensor> known_levels(const TrainingScene& scene) const = 0;

  // Returns that level of all views encoded together, normalised: what is generated of it.
  torch::Tensor latent_of(const TrainingScene& scene, int64_t level, const LevelStatistics& statistics) const;
  // Returns what is made of the source views alone: all but a cascade's deeper level.
  DitSceneInputs conditioned_on_sources(const TrainingScene& scene) const;
  torch::Tensor images_of(const TrainingScene& scene, int64_t views) const {
    return scene.images.narrow(0, 0, views);
  }

  const BundleOptions& model() const { return model_; }
  const LevelGenerator& generator() const { return generator_; }
  const FlowObjectiveOptions& options() const { return options_; }
  const FrozenParts& frozen() const { return frozen_; }
  const DitDh& dit() const { return *dit_; }
  LatentGrid grid_of(const TrainingScene& scene) const;
  void export_model(const std::filesystem::path& folder, DType dtype) const override;

 private:
  struct Errors {
    FlowMatchingErrors velocity;
    torch::Tensor correspondence;  // a scalar; undefined where it was not asked for or nothing is seen twice
  };
  // A scene of a step with what was drawn for it. truth: undefined shares leave the correspondence out.
  struct Drawn {
    SceneLatents latents;
    torch::Tensor noise;
    double time = 0.5;
    DitBranch branch = DitBranch::kConditional;
    TokenCorrespondence truth;
  };
  Drawn draw(const TrainingScene& on_host, torch::Generator& generator);
  SceneLatents with_nothing_carried(SceneLatents latents) const;
  // Returns the errors of each scene; scenes of one size are evaluated together.
  std::vector<Errors> velocity_errors(const std::vector<Drawn>& scenes) const;
  double training_shift(const TrainingScene& scene) const;
  // Takes Euler steps on the grid with that shift; the result is not a number throughout where they meet values that
  // are not finite.
  torch::Tensor generate(const DitSceneInputs& shown, const torch::Tensor& noise, double shift) const;

  // Decodes a generated latent to images (views, 3, height, width), for validation. Levels that nothing gives are zero.
  torch::Tensor decode(const TrainingScene& scene, const torch::Tensor& latent) const;

  BundleOptions model_;
  LevelGenerator generator_;
  FlowObjectiveOptions options_;
  FrozenParts frozen_;
  ParameterPlacement placement_;
  std::shared_ptr<DitDh> dit_;
  KeptLatents kept_latents_;
};

}  // namespace gld
