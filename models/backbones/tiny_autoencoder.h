#pragma once

#include "models/backbones/autoencoder.h"
#include "models/layers/convolution.h"

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// Defaults are TAEF2, the tiny autoencoder of FLUX.2's latents. TAESD and TAESDXL have latent_channels 4 and
// middle_norm false.
struct TinyAutoencoderOptions : AutoencoderArchitecture {
  int64_t latent_channels = 32;
  int64_t width = 64;        // channels of every map between image and latent
  bool middle_norm = true;   // blocks at the latent's size start with group norms over the map
  int64_t latent_patch = 2;  // latent pixels of a token along each side

  void visit(FieldVisitor& visitor) override;
  void check() const override;

  std::string kind() const override { return "tiny_autoencoder"; }
  std::unique_ptr<BackboneArchitecture> copy() const override;
  std::shared_ptr<Backbone> make(const ParameterPlacement& placement) const override;
  std::string published_prefix() const override { return ""; }
  int64_t patch_side() const override { return 8 * latent_patch; }
  int64_t latent_pixels() const override { return latent_patch; }
  int64_t level_channels() const override { return latent_channels * latent_patch * latent_patch; }
  Cost encoding_cost(const LatentGrid& grid, int64_t last_level) const override;
  Cost decoding_cost(const LatentGrid& grid) const override;
};

// The tiny autoencoders of O. B. Bohan (taesd.py of the published code), encoder. and decoder. in front of the
// published names. Images and latents are taken as they are, without scaling; the decoder bounds latents by 3 tanh(z /
// 3).
class TinyAutoencoder : public Autoencoder {
 public:
  TinyAutoencoder(const TinyAutoencoderOptions& options, const ParameterPlacement& placement);

  const TinyAutoencoderOptions& architecture() const override { return options_; }
  using Backbone::encode;
  std::vector<torch::Tensor> encode(const torch::Tensor& images, int64_t last_level,
                                    std::vector<AttentionTap>* taps) const override;
  Autoencoding autoencode(const torch::Tensor& images, const torch::Generator& generator) const override;
  void initialise(const torch::Generator& generator) override;

  torch::Tensor latents_of(
      const torch::Tensor& images) const;  // (views, latent_channels, height / 8, width / 8)
  torch::Tensor images_of(const torch::Tensor& latents) const;  // RGB in about [0, 1], not clamped

 protected:
  torch::Tensor decoded_view(const torch::Tensor& latents) const override;

 private:
  using Step = std::function<torch::Tensor(const torch::Tensor&)>;
  TinyAutoencoderOptions options_;
  std::vector<Step> encoder_, decoder_;  // in the order of running
};

}  // namespace gld
