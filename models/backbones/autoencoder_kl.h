#pragma once

#include "models/backbones/autoencoder.h"
#include "models/layers/convolution.h"

#include <cstdint>
#include <memory>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

enum class Posterior { kMean, kSample };

// Defaults are Stable Diffusion 1.x and 2.x. SDXL has scaling_factor 0.13025.
struct AutoencoderKlOptions : AutoencoderArchitecture {
  int64_t latent_channels = 4;
  std::vector<int64_t> block_out_channels = {128, 256, 512, 512};  // each but the last halves the sides
  int64_t layers_per_block = 2;
  int64_t norm_groups = 32;
  double scaling_factor = 0.18215;  // of latents, after the shift
  double shift_factor = 0;          // subtracted from latents
  Posterior posterior = Posterior::kMean;
  int64_t posterior_seed = 0;  // of Posterior::kSample
  int64_t latent_patch = 2;    // latent pixels of a token along each side

  void visit(FieldVisitor& visitor) override;
  void check() const override;

  std::string kind() const override { return "autoencoder_kl"; }
  std::unique_ptr<BackboneArchitecture> copy() const override;
  std::shared_ptr<Backbone> make(const ParameterPlacement& placement) const override;
  std::string published_prefix() const override { return ""; }
  // Returns how many image pixels a latent pixel has along each side, 8 by default.
  int64_t reduction() const { return int64_t{1} << (block_out_channels.size() - 1); }
  int64_t patch_side() const override { return reduction() * latent_patch; }
  int64_t latent_pixels() const override { return latent_patch; }
  int64_t level_channels() const override { return latent_channels * latent_patch * latent_patch; }
  Cost encoding_cost(const LatentGrid& grid, int64_t last_level) const override;
  Cost decoding_cost(const LatentGrid& grid) const override;
};

class AutoencoderKlHalf;

// The convolutional autoencoder of latent diffusion (Rombach et al. 2022) under the names of diffusers' AutoencoderKL.
// Its one level is the latent of scaling_factor, in tokens of latent_patch x latent_patch latent pixels; views are
// worked on one by one, so that memory is that of one. A sample of the posterior depends on posterior_seed and the
// image alone.
class AutoencoderKl : public Autoencoder {
 public:
  AutoencoderKl(const AutoencoderKlOptions& options, const ParameterPlacement& placement);

  const AutoencoderKlOptions& architecture() const override { return options_; }
  using Backbone::encode;
  std::vector<torch::Tensor> encode(const torch::Tensor& images, int64_t last_level,
                                    std::vector<AttentionTap>* taps) const override;
  Autoencoding autoencode(const torch::Tensor& images, const torch::Generator& generator) const override;
  void initialise(const torch::Generator& generator) override;

  // Returns what the encoder gives for images (views, 3, height, width), RGB in [0, 1]: mean and logarithm of the
  // variance, clamped to [-30, 20], (views, 2 latent_channels, height', width'), before scaling.
  torch::Tensor moments(const torch::Tensor& images) const;
  // Decodes latents before scaling to images, RGB in about [0, 1].
  torch::Tensor images_of(const torch::Tensor& latents) const;

 protected:
  torch::Tensor decoded_view(const torch::Tensor& latents) const override;

 private:
  AutoencoderKlOptions options_;
  std::shared_ptr<AutoencoderKlHalf> encoder_, decoder_;
  std::shared_ptr<Convolution> quant_, post_quant_;
};

}  // namespace gld
