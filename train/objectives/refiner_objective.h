#pragma once

#include "models/bundle/bundle.h"
#include "models/losses/perceptual_loss.h"
#include "models/refiner/denoising_unet.h"
#include "train/loop/objective.h"

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <torch/types.h>

namespace gld {

// Decoded pictures are compared with this.
enum class RefinerTruth {
  kDecoded,     // what the autoencoder makes of the true view's latents (Splatent's paper)
  kPhotograph,  // the true view (its code)
};

struct RefinerObjectiveOptions : OptionsGroup {
  ModelStart start = ModelStart::kRandom;
  double latent_weight = 1;   // of the mean squared error of latents
  double picture_weight = 1;  // of the mean squared error of decoded pictures, in [-1, 1]
  PerceptualOptions perceptual;
  RefinerTruth truth = RefinerTruth::kDecoded;
  // First steps in which the network learns to see through noise, of encoded latents at random timesteps, beside the
  // same references: what a checkpoint of Stable Diffusion brings.
  int64_t denoising_steps = 0;
  // So many steps behind denoising_steps in which latents alone count: decoded pictures take half of a step's time.
  int64_t latent_steps = 0;

  RefinerObjectiveOptions();
  void visit(FieldVisitor& visitor) override;
};

// Trains the one-step refiner (models/refiner) on degraded latents of views whose encoded latents are known, beside
// their nearest views (Splatent, arXiv 2512.09923, section 4.3), by latent_weight MSE(z) + picture_weight MSE(D(z)) +
// perceptual.weight perceptual(D(z)). Scenes have their references first and one target.
class RefinerObjective : public Objective {
 public:
  // latents says how the autoencoder's are normalised.
  RefinerObjective(const BundleOptions& model, const RefinerObjectiveOptions& options,
                   std::shared_ptr<Backbone> autoencoder, const LatentStatistics& latents,
                   const ParameterPlacement& placement, int64_t seed);
  // Goes on with a trained network of the same architecture.
  void start_from(std::shared_ptr<DenoisingUnet> trained) { unet_ = std::move(trained); }

  std::string kind() const override { return "refiner"; }
  torch::Device device() const override { return placement_.device; }
  bool concurrent() const override { return true; }
  int64_t learn_in(ComputePrecision precision) override;
  std::vector<NamedParameter> parameters() const override;
  std::vector<NamedParameter> untrained() const override;
  Losses losses(const TrainingBatch& batch, const StepContext& context) override;
  Validation validate(const std::vector<TrainingScene>& scenes) override;
  void export_model(const std::filesystem::path& folder, DType dtype) const override;

 private:
  Losses denoising_losses(const torch::Tensor& views, const torch::Tensor& truth,
                          const StepContext& context) const;
  // Returns the mean squared error of what the network takes for the noise, of variance 1, where truth (scenes,
  // channels, height, width), encoded latents, is seen through it in the place of the first of `views` (scenes, views,
  // channels, height, width).
  torch::Tensor denoising_error(const torch::Tensor& views, const torch::Tensor& truth,
                                const torch::Tensor& noise, int64_t timestep) const;
  // Decodes normalised latents (views, channels, height, width) to images, RGB in about [0, 1].
  torch::Tensor decoded(const torch::Tensor& latents) const;

  BundleOptions model_;
  RefinerObjectiveOptions options_;
  ParameterPlacement placement_;
  std::shared_ptr<Backbone> autoencoder_;
  LatentStatistics latents_;
  PerceptualLoss perceptual_;
  std::shared_ptr<DenoisingUnet> unet_;
};

}  // namespace gld
