#pragma once

#include "models/blending/photograph_blending.h"
#include "models/bundle/bundle.h"
#include "models/depth_refinement/depth_refinement.h"
#include "models/latent_spaces/latent_space.h"
#include "models/losses/perceptual_standin.h"
#include "train/loop/objective.h"
#include "train/objectives/kept_scenes.h"

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <torch/types.h>

namespace gld {

struct BlendingObjectiveOptions : OptionsGroup {
  ModelStart start = ModelStart::kRandom;
  // How often photographs are carried by their true depth, so that what is right is left as it is.
  double true_depth = 0.25;
  double logarithmic_weight = 0.1;  // of log(mean squared error): good views count as much as bad ones
  double perceptual_weight = 0.2;
  PerceptualStandinOptions perceptual;
  double kept_gib = 0;  // of what scenes that were seen before are chosen from

  void visit(FieldVisitor& visitor) override;
};

// What is frozen while the blending learns.
struct BlendingDepthModels {
  std::shared_ptr<const Backbone> backbone;
  std::shared_ptr<const GeometryHead> head;
  std::shared_ptr<const DepthRefinement> refinement;  // null for a model without
};

// Trains the blending of photographs (models/blending) on the depth that frozen networks, and the photographs
// themselves, say of scenes with two sources or more: 2 mean |off| + logarithmic_weight log(mean off^2)
// + perceptual_weight perceptual_standin(), over the target views.
class BlendingObjective : public Objective {
 public:
  BlendingObjective(const BundleOptions& model, const BlendingObjectiveOptions& options,
                    const BlendingDepthModels& depth_models, int64_t seed);
  // Goes on with a trained network of the same architecture.
  void start_from(std::shared_ptr<PhotographBlending> trained) { blending_ = std::move(trained); }

  // Keeps what pictures are chosen from in that folder too.
  void keep_in(std::shared_ptr<const KeptFolder> folder) { kept_.keep_in(std::move(folder)); }

  std::string kind() const override { return "blending"; }
  torch::Device device() const override { return torch::kCPU; }
  bool concurrent() const override { return true; }
  int64_t learn_in(ComputePrecision precision) override;
  std::vector<NamedParameter> parameters() const override;
  std::vector<NamedParameter> untrained() const override;
  Losses losses(const TrainingBatch& batch, const StepContext& context) override;
  Validation validate(const std::vector<TrainingScene>& scenes) override;
  void export_model(const std::filesystem::path& folder, DType dtype) const override;

 private:
  enum class DepthOf { kModel, kTruth };
  // Returns what the target views of a scene are chosen from, float16; colours are undefined where depth is not known.
  BlendingCandidates candidates_of(const TrainingScene& scene, DepthOf depth) const;
  BlendingCandidates kept_candidates_of(const TrainingScene& scene, DepthOf depth);

  BundleOptions model_;
  BlendingObjectiveOptions options_;
  LatentSpace space_;
  BlendingDepthModels depth_models_;
  std::shared_ptr<PhotographBlending> blending_;
  KeptScenes kept_;
};

}  // namespace gld
