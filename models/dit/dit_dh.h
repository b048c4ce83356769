#pragma once

#include "models/dit/dit_block.h"
#include "models/dit/dit_embedder.h"
#include "models/dit/dit_options.h"
#include "models/dit/dit_scene.h"
#include "models/layers/activation_checkpoint.h"
#include "models/layers/layers.h"
#include "models/layers/time_embedding.h"

#include <memory>
#include <string>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// What the backward pass of training finds: every intermediate tensor, or only the outputs of attention and the input
// of every second block, from which the rest is computed again (models/layers/activation_checkpoint.h; without the CPU
// kernels the input of every block alone). The same gradients.
enum class ActivationStorage { kKeep, kRecompute };

// DiT^DH (DESIGN.md section 4) gives the velocity of the joint latent of all views of a scene. A condition encoder
// turns source features, cameras and the noisy latent (or a deeper level) into one condition a token, which modulates a
// wide and shallow velocity decoder. Parameters have the names of the published checkpoints.
//
// An evaluation takes passes (DitPasses): scenes x branches of guidance. Views attend within their pass; all else is
// one product over the tokens of all. One scene in one branch is the case of one.
//
// First guess (DitOptions::carried_error): the sources' features w that were carried into a target view are a first
// guess of its data x, with errors of variance s^2 where photographs agree. x_t = (1 - t) x + t noise is another one,
// of variance (t / (1 - t))^2, and the best linear mixture of both rests on w by
//   lambda(t) = t^2 / (t^2 + s^2 (1 - t)^2).
// What the network F predicts is mixed with w so: x = (1 - m) F + m w, m = lambda(t) trust, where trust is how far
// photographs agree at a token times a learnt share; for a network G that predicts the velocity that is
//   v = (1 - m) G + (m / t) (x_t - w).
// So what is in sight need not pass through the network's width, and towards t = 0 the network alone decides. The
// unconditional branch has m = 0.
//
// In a mixture the network cannot correct what is trusted: at t = 1 its share is 1 - trust. With
// CarriedGuess::kCorrected all guesses are taken together, the latent's own mean 0 and variance 1, w with s^2 / trust
// and x_t / (1 - t): their best linear estimate has the variance
//   sigma^2 = t^2 / D, D = t^2 (1 + trust / s^2) + (1 - t)^2,
// and x = (t^2 trust / s^2 w + (1 - t) x_t) / D + sigma F, so that F has to have variance 1 at every t and everywhere
// (the preconditioning of Karras et al. 2022, table 1, with one more guess). The velocity (x_t - x) / t is
//   ((t (1 + trust / s^2) - (1 - t)) x_t - t trust / s^2 w) / D - F / sqrt(D),
// which needs no bound of 1/t. Branches and views without w have trust 0.
//
// Latents are (views, tokens, channels), special tokens first. Every function records gradients unless the caller holds
// a NoGradGuard.
class DitDh : public torch::nn::Module {
 public:
  // Throws Error for options that do not fit together.
  DitDh(const DitOptions& options, const ParameterPlacement& placement);

  const DitOptions& options() const { return options_; }
  // Returns the tokens of one view, special ones included.
  int64_t tokens_per_view(const LatentGrid& grid) const {
    return options_.num_special_tokens + grid.tokens_per_view();
  }

  // Throws Error where cameras and latents do not match.
  DitScene prepare_scene(const DitSceneInputs& inputs, const ExactSavings& savings = {}) const;

  // Returns one DitTimeRow a time; rows is how many equal rows each has (1, or one a view).
  std::vector<DitTimeRow> time_rows(const std::vector<double>& times, int64_t rows = 1) const;

  DitNoisyTokens embed_noisy(const DitScene& scene, const torch::Tensor& noisy) const;
  // Embeds those of several scenes: noisy is (scenes * views, tokens, channels).
  DitNoisyTokens embed_noisy(const DitPasses& passes, const torch::Tensor& noisy) const;
  // Returns the condition of every token before flow time and SiLU, (passes * views, tokens, encoder width). Tokens are
  // those of each pass, or of one that all share (the branches of one scene).
  torch::Tensor condition_encoder(const DitPasses& passes, const DitNoisyTokens& tokens) const;
  // Returns what the last linear layer gets, (passes * views, tokens, decoder width), from the condition of each pass;
  // with carried_error it is what with_first_guess() makes of it.
  torch::Tensor velocity_features(const DitPasses& passes, const DitNoisyTokens& tokens,
                                  const torch::Tensor& condition) const;
  // Returns the features of models without carried_error as they are; of models with it, features scaled by 1 - m, and
  // behind them 1 - m and m w (of a predicted velocity m w / t), (passes * views, tokens, decoder width + 1 +
  // channels), in which the mixture is linear, so that branches can be mixed as features are. Of kCorrected these are
  // the parts of the velocity: features scaled by -1 / sqrt(D), that factor, the part of w, and (one more channel) the
  // factor of x_t.
  torch::Tensor with_first_guess(const DitPasses& passes, const torch::Tensor& features) const;
  // Applies the last linear layer, which is affine in the features: (views, tokens, channels). noisy, the latent at
  // that time, is where the velocity of a model that predicts the data starts from; branches mixed before need it once.
  torch::Tensor velocity_from_features(const torch::Tensor& features, const torch::Tensor& noisy,
                                       double time) const;

  // Does all of it: (passes * views, tokens, channels).
  torch::Tensor velocity(const DitPasses& passes, const torch::Tensor& noisy) const;
  // The case of one scene.
  torch::Tensor velocity(const DitScene& scene, const torch::Tensor& noisy, const DitTimeRow& time,
                         DitBranch branch = DitBranch::kConditional) const {
    return velocity({{&scene, &time, branch}}, noisy);
  }

  // Draws random weights as the published training starts: embedders Xavier uniform, time embedding normal 0.02, AdaLN
  // and last layers zero, other layers uniform +-1/sqrt(inputs). They are drawn on the CPU in the order of the names.
  void initialise(const torch::Generator& generator);

  void set_activation_storage(ActivationStorage storage) { activation_storage_ = storage; }

 private:
  // Runs them one after the other, with the passes' cameras; modulations has one a block.
  torch::Tensor run_blocks(const std::vector<std::shared_ptr<DitBlock>>& blocks, torch::Tensor x,
                           const DitPasses& passes, const std::vector<DitBranchCameras>& cameras,
                           const std::vector<Modulation>& modulations) const;
  // Does what with_first_guess() does for CarriedGuess::kCorrected.
  torch::Tensor with_estimate(const DitPasses& passes, const torch::Tensor& features) const;
  // Returns what the network says of features: the velocity, or the data.
  torch::Tensor output_of(const torch::Tensor& features) const;
  // Runs a part without attention, kept or computed again as the blocks are.
  torch::Tensor by_storage(const PartFunction& part, const torch::Tensor& x,
                           const torch::Tensor& conditioning) const;
  void check_latent(const DitScene& scene, const torch::Tensor& latent, const std::string& name,
                    int64_t views) const;
  torch::TensorOptions tensor_options() const;
  // These make what is added to the patch tokens (zero for special tokens), and the PRoPE tables.
  torch::Tensor camera_embedding(const DitScene& scene, DitBranch branch) const;
  // Returns patch tokens of the target views with zeros for source views and special tokens.
  torch::Tensor for_all_views(const DitScene& scene, const torch::Tensor& target_patches) const;
  void fill_embeddings(const DitScene& scene, DitBranch branch, DitBranchCameras& cameras) const;
  void fill_first_guess(DitScene& scene) const;
  void check_warp(const DitScene& scene, const DitSceneInputs& inputs) const;
  PropeTables prope_tables(const DitScene& scene, DitBranch branch, int64_t head_dim) const;
  void fill_prope(const DitScene& scene, DitBranch branch, DitBranchCameras& cameras) const;
  std::vector<DitBranchCameras> evaluation_cameras(const DitPasses& passes) const;
  // These make the embeddings of special and patch tokens: of the source features, of the noisy latent, and of both in
  // one product.
  torch::Tensor source_part(const DitEmbedder& embedder, const DitScene& scene) const;
  torch::Tensor latent_part(const DitEmbedder& embedder, const DitScene& scene,
                            const torch::Tensor& noisy) const;
  torch::Tensor joint_tokens(const DitEmbedder& embedder, const DitScene& scene, const torch::Tensor& patches,
                             const torch::Tensor& noisy) const;
  torch::Tensor with_positions(const torch::Tensor& tokens, const DitScene& scene) const;
  torch::Tensor encoder_tokens(const DitScene& scene, const torch::Tensor& noisy) const;
  torch::Tensor decoder_tokens(const DitScene& scene, const torch::Tensor& noisy) const;

  DitOptions options_;
  ActivationStorage activation_storage_ = ActivationStorage::kKeep;
  std::unique_ptr<DitEmbedder> encoder_embedder_, decoder_embedder_;
  std::shared_ptr<Linear> condition_projection_;  // null where both widths are equal
  std::shared_ptr<TimeEmbedding> time_embedding_;
  std::shared_ptr<PatchEmbed> camera_embedder_;
  std::shared_ptr<PatchEmbed> warp_embedder_;   // null without warped_sources
  std::shared_ptr<Linear> guess_gate_;          // null without carried_error
  std::shared_ptr<Linear> special_projection_;  // null without special tokens
  std::shared_ptr<DitFinalLayer> final_layer_;
  std::vector<std::shared_ptr<DitBlock>> encoder_blocks_, decoder_blocks_;
};

}  // namespace gld
