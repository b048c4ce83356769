#pragma once

#include "models/bundle/bundle.h"
#include "train/loop/objective.h"
#include "train/objectives/geometry_loss.h"

#include <cstdint>
#include <memory>
#include <vector>

#include <torch/types.h>

namespace gld {

enum class GeometryTraining {
  kFromScratch,  // backbone and DPT head, from random weights
  kHeadOnly,  // the DPT head of the bundle goes on learning; the backbone is frozen, so that decoders and latent
              // models that were trained on its features stay valid
};

struct BackboneObjectiveOptions : OptionsGroup {
  GeometryTraining training = GeometryTraining::kFromScratch;
  GeometryLossOptions loss;
  std::vector<double> pixel_weights = {1.0, 0.5};  // of levels 0, 1, ...
  double all_views_probability = 0.5;
  // kHeadOnly: of the noise on what the head reads, in deviations of a channel (feature_noise.h).
  double feature_noise = 0;

  void visit(FieldVisitor& visitor) override;
};

struct TrainedGeometry {
  std::shared_ptr<Backbone> backbone;
  std::shared_ptr<DptHead> head;
};

// Trains a geometric backbone and its DPT head from scratch on scenes with depth (geometry_loss.h).
//
// Depth alone would let a backbone forget colour, and the RGB decoder could then not give images back: the
// published backbone keeps colour in its shallow levels because it starts from DINOv2, ours has to be told. So one
// linear layer a level (0 and 1 by default) predicts the patch's pixels from the level as decoders take it, with
// an absolute error. A linear layer, because it leaves the work to the backbone: what it can read off, the
// decoder and the latent models find there as well. The pixel layers are not part of the exported model.
//
// A scene is shown with all its views or with its first 1..V-1 ones, because later stages encode the source views
// alone and single views too.
class BackboneObjective : public Objective {
 public:
  // model: the architecture; trained: the parts that kHeadOnly goes on with, null for kFromScratch.
  BackboneObjective(const BundleOptions& model, const BackboneObjectiveOptions& options,
                    const ParameterPlacement& placement, int64_t seed, const TrainedGeometry& trained = {});

  std::string kind() const override { return "backbone"; }
  torch::Device device() const override { return placement_.device; }
  bool concurrent() const override { return true; }
  std::vector<NamedParameter> parameters() const override;
  Losses losses(const TrainingBatch& batch, const StepContext& context) override;
  Validation validate(const std::vector<TrainingScene>& scenes) override;
  void export_model(const std::filesystem::path& folder, DType dtype) const override;

 private:
  struct SceneResult {
    GeometryLosses geometry;
    std::vector<torch::Tensor> pixel_errors;  // a level each, scalars
    GeometryOutput output;
    torch::Tensor shallow_image;  // (views, 3, height, width), what level 0 still shows
  };
  // noisy: where feature_noise is drawn from; none for validation.
  SceneResult evaluate(const TrainingScene& scene, int64_t views, torch::Generator* noisy = nullptr) const;
  bool head_only() const { return options_.training == GeometryTraining::kHeadOnly; }

  BundleOptions model_;
  BackboneObjectiveOptions options_;
  ParameterPlacement placement_;
  std::shared_ptr<Backbone> backbone_;
  std::shared_ptr<DptHead> head_;
  std::vector<std::shared_ptr<Linear>> pixel_layers_;
};

}  // namespace gld
