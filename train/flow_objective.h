#pragma once

#include "gld/latent_statistics.h"
#include "models/bundle.h"
#include "train/correspondence.h"
#include "train/objective.h"
#include "train/scene_latents.h"

#include <cstdint>
#include <memory>
#include <vector>

#include <torch/types.h>

namespace gld {

struct FlowObjectiveOptions : OptionsGroup {
  ModelStart start = ModelStart::kRandom;
  double camera_dropout = 0.1;
  int64_t validation_evaluations = 8;
  bool checkpoint_blocks = false;
  double correspondence_weight = 0;
  std::vector<int64_t> correspondence_blocks;  // counted from 0, the condition encoder's first
  double kept_latents_gib = 0;                 // of scenes seen before; 0 encodes every time

  void visit(FieldVisitor& visitor) override;
};

// What a diffusion objective needs beside the model it trains; nothing here is changed.
struct FrozenParts {
  std::shared_ptr<const Da3Backbone> backbone;
  LatentStatistics level0_statistics;  // the cascade only
  LatentStatistics boundary_statistics;
  std::shared_ptr<const RgbDecoder> rgb_decoder;  // for validation pictures; may be null
};

// Flow matching of the joint latent of all views (DESIGN.md section 4, "Flow"): one flow time a scene, uniform and
// then shifted; x_t = (1 - t) x_data + t noise for all views; mean squared error of the velocity noise - x_data over
// all views, with the parts of source and target views logged apart. With probability camera_dropout a scene is
// shown without cameras, as the unconditional branch of guidance sees it.
//
// With correspondence_weight (scenes with depth) the attention of correspondence_blocks is taught in which tokens of the
// source views the surface of each token is seen (train/correspondence.h): novel views are made by fetching it there, and
// by the flow's loss alone attention finds that out late.
class FlowObjective : public Objective {
 public:
  torch::Device device() const override { return placement_.device; }
  // Recomputed activations write gradients where the parameters are.
  bool concurrent() const override { return !options_.checkpoint_blocks; }
  std::vector<NamedParameter> parameters() const override;
  // Takes over the weights of a trained model of the same architecture.
  void start_from(const DitDh& trained);
  Losses losses(const TrainingBatch& batch, const StepContext& context) override;
  Validation validate(const std::vector<TrainingScene>& scenes) override;

 protected:
  // What the frozen backbone makes of a scene, normalised; the model has to generate clean.
  virtual SceneLatents latents(const TrainingScene& scene) const = 0;

  // A scene as the model sees it, and the latent it has to generate: (views, tokens, channels), normalised.
  struct Prepared {
    DitSceneInputs inputs;
    torch::Tensor clean;
  };

  FlowObjective(const BundleOptions& model, const DitOptions& dit, double training_shift,
                const FlowObjectiveOptions& options, FrozenParts frozen, const ParameterPlacement& placement,
                int64_t seed);

  // generator: random numbers that belong to the training of this scene.
  virtual Prepared prepare(const TrainingScene& scene, const SceneLatents& latents,
                           torch::Generator& generator) const = 0;
  // A generated latent as images (views, 3, height, width), for validation.
  virtual torch::Tensor decode(const TrainingScene& scene, const torch::Tensor& latent) const = 0;

  // Raw levels 0..last of the first `views` views, without gradients.
  std::vector<torch::Tensor> encode(const TrainingScene& scene, int64_t views, int64_t last) const;
  static torch::Tensor patches_of(const torch::Tensor& level) {
    return level.narrow(1, 1, level.size(1) - 1);
  }

  const BundleOptions& model() const { return model_; }
  const FlowObjectiveOptions& options() const { return options_; }
  const FrozenParts& frozen() const { return frozen_; }
  const DitDh& dit() const { return *dit_; }
  LatentGrid grid_of(const TrainingScene& scene) const;

 private:
  struct Errors {
    torch::Tensor all, source, target;  // scalars
    torch::Tensor correspondence;  // the same; undefined where it was not asked for or nothing is seen twice
  };
  // truth: undefined shares leave the correspondence out.
  Errors velocity_errors(const Prepared& prepared, const torch::Tensor& noise, double time, DitBranch branch,
                         const TokenCorrespondence& truth = {}) const;
  // Euler steps on the shifted grid; the first evaluations' prediction of the data is kept.
  torch::Tensor generate(const Prepared& prepared, const torch::Tensor& noise) const;

  BundleOptions model_;
  double training_shift_;
  FlowObjectiveOptions options_;
  FrozenParts frozen_;
  ParameterPlacement placement_;
  std::shared_ptr<DitDh> dit_;
  KeptLatents kept_latents_;
};

}  // namespace gld
