#pragma once

#include "models/bundle/bundle.h"
#include "train/loop/objective.h"
#include "train/objectives/geometry_loss.h"

#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include <torch/types.h>

namespace gld {

enum class GeometryTraining {
  kFromScratch,  // backbone and geometry head, from random weights
  kFromBundle,   // both go on learning from the bundle's weights
  kHeadOnly,  // the geometry head of the bundle goes on learning; the backbone is frozen, so that decoders and latent
              // models that were trained on its features stay valid
};

struct BackboneObjectiveOptions : OptionsGroup {
  GeometryTraining training = GeometryTraining::kFromScratch;
  GeometryLossOptions loss;
  std::vector<double> pixel_weights = {1.0, 0.5};  // of levels 0, 1, ...
  std::vector<double> geometry_weights = {};       // the same
  double head_probability = 1.0;
  double all_views_probability = 0.5;
  double known_cameras = 0;
  double correspondence_weight = 0;
  std::vector<int64_t> correspondence_blocks;  // counted from 0; blocks that attend over all views
  // With kHeadOnly this is the deviation of the strength of the noise on what the head reads, in deviations of a
  // channel (feature_noise.h).
  double feature_noise = 0;

  void visit(FieldVisitor& visitor) override;
};

struct TrainedGeometry {
  std::shared_ptr<Backbone> backbone;
  std::shared_ptr<GeometryHead> head;
};

// Trains a geometric backbone and its geometry head from scratch on scenes with depth (geometry_loss.h).
//
// Depth alone would let a backbone forget colour, and the RGB decoder could then not give images back: the published
// backbone keeps colour in its shallow levels because it starts from DINOv2, ours has to be told. So one linear layer a
// level (0 and 1 by default) predicts the patch's pixels from the level as decoders take it, with an absolute error. It
// is a linear layer, because it leaves the work to the backbone: what it can read off, the decoder and the latent
// models find there as well. The pixel layers are not part of the exported model.
//
// In the same way geometry_weights have linear layers read depth and rays off each level's tokens: what makes a shallow
// level one of geometry. They cost next to nothing, whereas the geometry head is most of a step: with head_probability
// below 1 it sees only that share of the scenes, and the backbone learns from several times as many in the same time.
//
// With correspondence_weight the attention of correspondence_blocks is taught where each token is seen in the other
// views (train/objectives/correspondence.h): relative poses follow from that, and alone they take far longer to be
// learnt.
//
// With known_cameras the backbone is told the cameras of that share of the scenes (Depth Anything 3 tells them in a
// fifth), so that it takes them where they are known and finds them where they are not; depth and rays stay in the unit
// of GeometryTargets.
//
// A scene is shown with all its views or with its first 1..V-1 ones, because later stages encode the source views alone
// and single views too.
class BackboneObjective : public Objective {
 public:
  // model is the architecture; trained holds the parts that are gone on with, null for kFromScratch.
  BackboneObjective(const BundleOptions& model, const BackboneObjectiveOptions& options,
                    const ParameterPlacement& placement, int64_t seed, const TrainedGeometry& trained = {});

  std::string kind() const override { return "backbone"; }
  torch::Device device() const override { return placement_.device; }
  bool concurrent() const override { return true; }
  int64_t learn_in(ComputePrecision precision) override;
  std::vector<NamedParameter> parameters() const override;
  std::vector<NamedParameter> untrained() const override;
  Losses losses(const TrainingBatch& batch, const StepContext& context) override;
  Validation validate(const std::vector<TrainingScene>& scenes) override;
  void export_model(const std::filesystem::path& folder, DType dtype) const override;

 private:
  // Throws Error after many scenes in a row of which geometry was asked and no depth was known.
  void count_depth(const TrainingScene& scene, bool asked, bool known);
  struct SceneResult {
    GeometryLosses geometry;                        // of the head; undefined where it was left out
    std::vector<torch::Tensor> pixel_errors;        // a level each, scalars
    std::vector<TokenGeometryLosses> token_errors;  // the same; undefined totals where the weight is 0
    GeometryOutput output;                          // undefined where the head was left out
    RayErrors rays;                                 // without gradients only: validation
    torch::Tensor correspondence;                   // scalar; undefined without such a loss
    torch::Tensor shallow_image;                    // (views, 3, height, width), what level 0 still shows
  };
  struct Showing {
    int64_t views = 0;  // the first ones
    bool head = true;
    bool known_cameras = false;
    torch::Generator* noisy = nullptr;  // where feature_noise is drawn from; none for validation
  };
  SceneResult evaluate(const TrainingScene& scene, const Showing& showing) const;
  bool head_only() const { return options_.training == GeometryTraining::kHeadOnly; }

  BundleOptions model_;
  BackboneObjectiveOptions options_;
  ParameterPlacement placement_;
  std::shared_ptr<Backbone> backbone_;
  std::shared_ptr<GeometryHead> head_;  // null where the model has none
  std::vector<std::shared_ptr<Linear>> pixel_layers_;
  std::vector<std::shared_ptr<Linear>> geometry_layers_;  // null where the weight is 0
  std::atomic<int64_t> without_depth_{0};                 // scenes, by all workers
};

}  // namespace gld
