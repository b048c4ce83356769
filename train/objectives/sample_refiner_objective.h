#pragma once

#include "models/bundle/bundle.h"
#include "models/dit/dit_dh.h"
#include "models/refiner/denoising_unet.h"
#include "train/loop/objective.h"
#include "train/objectives/frozen_parts.h"

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <torch/types.h>

namespace gld {

struct SampleRefinerObjectiveOptions : OptionsGroup {
  ModelStart start = ModelStart::kRandom;
  CarryingDepth carried_by = CarryingDepth::kHead;  // for models with warped_sources
  // A scene is sampled with so many evaluations a level, drawn between these two.
  int64_t least_evaluations = 4;
  int64_t most_evaluations = 6;
  double guidance_scale = 1.5;
  int64_t validation_evaluations = 4;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// The models that a refiner repairs samples of, in the order in which they generate; nothing of them is changed.
struct FrozenGenerators {
  std::vector<std::shared_ptr<const DitDh>> models;
  std::vector<LevelStatistics> statistics;
};

// Trains the one-step refiner (models/refiner) on a model's own samples of few evaluations: the target views' latents,
// each beside the exact latents of the source views nearest to it, by the mean squared error of what the backbone makes
// of the true view. The sampling is the default of gld sample, with fewer evaluations.
class SampleRefinerObjective : public Objective {
 public:
  SampleRefinerObjective(const BundleOptions& model, const SampleRefinerObjectiveOptions& options,
                         FrozenParts frozen, FrozenGenerators generators, const ParameterPlacement& placement,
                         int64_t seed);
  // Goes on with a trained network of the same architecture.
  void start_from(std::shared_ptr<DenoisingUnet> trained) { unet_ = std::move(trained); }

  std::string kind() const override { return "sample refiner"; }
  torch::Device device() const override { return placement_.device; }
  bool concurrent() const override { return true; }
  int64_t learn_in(ComputePrecision precision) override;
  std::vector<NamedParameter> parameters() const override;
  std::vector<NamedParameter> untrained() const override;
  Losses losses(const TrainingBatch& batch, const StepContext& context) override;
  // Beside the sample that is repaired, values are of one with the default's evaluations, of the same noise.
  Validation validate(const std::vector<TrainingScene>& scenes) override;
  void export_model(const std::filesystem::path& folder, DType dtype) const override;

 private:
  // Of all generated levels, in their order, normalised.
  using Levels = std::vector<torch::Tensor>;
  // Exact latents of the source views, encoded alone, and of all views, encoded together.
  struct Encoded {
    SourceConditioning sources;
    Levels source_levels, all_levels;
  };
  Encoded encoded(const TrainingScene& scene) const;
  Levels noise(const TrainingScene& scene, torch::Generator& generator) const;
  Levels sampled(const TrainingScene& scene, const SourceConditioning& sources, const Levels& noise,
                 int64_t evaluations) const;
  LatentGrid grid_of(const TrainingScene& scene) const;
  // Returns the target views' maps of a sample, (targets, channels, height, width), repaired.
  torch::Tensor refined(const TrainingScene& scene, const Encoded& encoded, const Levels& sample) const;
  torch::Tensor target_maps(const TrainingScene& scene, const Levels& levels) const;
  torch::Tensor target_pictures(const TrainingScene& scene, const Levels& levels) const;

  BundleOptions model_;
  SampleRefinerObjectiveOptions options_;
  FrozenParts frozen_;
  FrozenGenerators generators_;
  ParameterPlacement placement_;
  std::shared_ptr<DenoisingUnet> unet_;
};

}  // namespace gld
