#pragma once

#include "models/bundle/bundle.h"
#include "models/losses/dino_discriminator.h"
#include "models/losses/discriminator.h"
#include "models/losses/perceptual_loss.h"
#include "train/loop/objective.h"
#include "train/objectives/diff_augment.h"
#include "train/optim/learning_rate.h"
#include "train/optim/optimiser.h"

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// The adversarial part (hinge loss; published defaults of decoder training).
struct AdversarialOptions : OptionsGroup {
  double weight = 0.75;             // 0: no discriminator at all
  int64_t generator_start = 0;      // first step at which the decoder sees the discriminator
  int64_t discriminator_start = 0;  // first step at which the discriminator learns
  double largest_adaptive_weight = 1e4;
  int64_t crop = 224;        // pixels; side of the random crop that is judged
  std::string dino_weights;  // file; empty: a small convolutional discriminator
  DinoDiscriminatorOptions dino;
  ConvolutionalDiscriminatorOptions convolutional;
  DiffAugmentOptions augment;
  // Counted in the discriminator's own steps: its warm-up starts when it starts to learn.
  LearningRateOptions learning_rate;
  OptimiserOptions optimiser;

  AdversarialOptions();
  void visit(FieldVisitor& visitor) override;
};

struct DecoderObjectiveOptions : OptionsGroup {
  ModelStart start = ModelStart::kRandom;
  double reconstruction_weight = 1.0;
  double level_dropout = 0.1;
  double latent_noise = 0.0;
  PerceptualOptions perceptual;
  AdversarialOptions adversarial;

  void visit(FieldVisitor& visitor) override;
};

// Returns what to tell whoever trains without the networks of the published recipe, a line each: which losses are
// stand-ins.
std::vector<std::string> stand_in_notes(const DecoderObjectiveOptions& options);

// Trains the RGB decoder on the features of a frozen backbone (paper, stage 1) by absolute error + perceptual loss +
// adversarial loss whose weight follows the ratio of gradient norms on the decoder's last layer (Esser et al. 2021, eq.
// 7). Each level of a scene is left out (zeros) with probability level_dropout, never all of them. latent_noise adds
// noise of random strength |N(0, latent_noise^2)| in units of each channel's deviation.
class DecoderObjective : public Objective {
 public:
  // model is the architecture; its RGB decoder is trained. backbone is not changed.
  DecoderObjective(const BundleOptions& model, const DecoderObjectiveOptions& options,
                   std::shared_ptr<const Backbone> backbone, const ParameterPlacement& placement,
                   int64_t seed);
  // Goes on with a trained decoder of the same architecture, in the place of random weights.
  void start_from(std::shared_ptr<RgbDecoder> trained) { decoder_ = std::move(trained); }

  std::string kind() const override { return "decoder"; }
  torch::Device device() const override { return placement_.device; }
  bool concurrent() const override { return true; }
  int64_t learn_in(ComputePrecision precision) override;
  bool spreads_over_processes() const override { return discriminator_ == nullptr; }
  std::vector<NamedParameter> parameters() const override;
  std::vector<NamedParameter> untrained() const override;
  Losses losses(const TrainingBatch& batch, const StepContext& context) override;
  std::vector<std::pair<std::string, double>> after_step(const StepContext& context) override;
  Validation validate(const std::vector<TrainingScene>& scenes) override;
  std::map<std::string, torch::Tensor> state() const override;
  void load_state(const std::map<std::string, torch::Tensor>& state, const std::string& where) override;
  void export_model(const std::filesystem::path& folder, DType dtype) const override;

 private:
  // Returns the four decodable levels, (views, tokens, channels) each.
  std::vector<torch::Tensor> levels_of(const torch::Tensor& images) const;
  torch::Tensor crop(const torch::Tensor& images, const std::vector<int64_t>& corner) const;
  std::vector<int64_t> draw_corner(const torch::Tensor& images, torch::Generator& generator) const;

  BundleOptions model_;
  DecoderObjectiveOptions options_;
  ParameterPlacement placement_;
  std::shared_ptr<const Backbone> backbone_;
  std::shared_ptr<RgbDecoder> decoder_;
  PerceptualLoss perceptual_;
  std::shared_ptr<Discriminator> discriminator_;
  std::unique_ptr<FlatParameters> discriminator_parameters_;
  std::unique_ptr<Optimiser> discriminator_optimiser_;
  // The discriminator learns from this after the step: images of every micro-batch of that step by its number, because
  // micro-batches are computed at the same time and end in any order.
  struct JudgedImages {
    torch::Tensor truth;
    torch::Tensor decoded;  // without gradients
  };
  void keep_for_discriminator(int64_t micro_batch, int64_t step, const JudgedImages& images);
  std::mutex judged_mutex_;
  std::map<int64_t, JudgedImages> judged_;
  int64_t judged_step_ = -1;  // the step they are of
};

}  // namespace gld
