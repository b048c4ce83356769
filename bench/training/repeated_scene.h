#pragma once

#include "gld/cameras/cameras_in_a_row.h"
#include "models/bundle/bundle_options.h"
#include "models/dit/dit_dh.h"
#include "models/dit/dit_scene.h"
#include "train/loop/objective.h"

#include <memory>
#include <vector>

#include <torch/types.h>

namespace gld {

// A training step is a forward pass and two products for each of its products.
constexpr double kForwardsAStep = 3;

// Flow matching of one random latent again and again, by the model and the loss that FlowObjective trains with: what
// benchmarks of training compute.
class RepeatedScene : public Objective {
 public:
  RepeatedScene(const BundleOptions& bundle, const DitOptions& options, const CameraRow& size,
                const torch::Device& device = torch::kCPU);

  void store(ActivationStorage storage) { dit_->set_activation_storage(storage); }
  double flop() const;  // of a forward pass
  const LatentGrid& grid() const { return grid_; }
  torch::Tensor loss() const;

  std::string kind() const override { return "bench"; }
  torch::Device device() const override { return clean_.device(); }
  int64_t learn_in(ComputePrecision precision) override;
  std::vector<NamedParameter> parameters() const override { return named_parameters(*dit_); }
  std::vector<NamedParameter> untrained() const override { return named_untrained(*dit_); }
  Losses losses(const TrainingBatch& /*batch*/, const StepContext& /*context*/) override {
    return {loss(), {}};
  }
  Validation validate(const std::vector<TrainingScene>& /*scenes*/) override { return {}; }
  void export_model(const std::filesystem::path& folder, DType dtype) const override;

 private:
  LatentGrid grid_;
  std::shared_ptr<DitDh> dit_;
  DitSceneInputs inputs_;
  torch::Tensor clean_, noise_;
};

}  // namespace gld
