#pragma once

#include "models/bundle/bundle.h"
#include "train/loop/objective.h"

#include <memory>
#include <vector>

namespace gld {

struct AutoencoderObjectiveOptions : OptionsGroup {
  double reconstruction_weight = 1.0;
  int64_t crop = 0;  // pixels: side of the square of each image that is learnt from; 0: all of it
  double divergence_weight = 1e-3;

  void visit(FieldVisitor& visitor) override;
};

// Trains a backbone that is an autoencoder by the mean absolute error of the images that its two halves give back, and
// how far its latents are from standard normal ones (Kingma and Welling 2013; the small weight of Rombach et al. 2022).
class AutoencoderObjective : public Objective {
 public:
  // trained holds weights to go on from; it is null for random ones.
  AutoencoderObjective(const BundleOptions& model, const AutoencoderObjectiveOptions& options,
                       const ParameterPlacement& placement, int64_t seed,
                       std::shared_ptr<Backbone> trained = nullptr);

  std::string kind() const override { return "autoencoder"; }
  torch::Device device() const override { return placement_.device; }
  bool concurrent() const override { return true; }
  int64_t learn_in(ComputePrecision precision) override;
  std::vector<NamedParameter> parameters() const override;
  std::vector<NamedParameter> untrained() const override;
  Losses losses(const TrainingBatch& batch, const StepContext& context) override;
  Validation validate(const std::vector<TrainingScene>& scenes) override;
  void export_model(const std::filesystem::path& folder, DType dtype) const override;

 private:
  BundleOptions model_;
  AutoencoderObjectiveOptions options_;
  ParameterPlacement placement_;
  std::shared_ptr<Backbone> backbone_;
};

}  // namespace gld
