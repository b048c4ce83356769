#pragma once

#include "models/backbones/backbone.h"

#include <vector>

#include <torch/types.h>

namespace gld {

// Autoencoders have this in common as backbones: their one level is the latent in tokens of latent_patch x latent_patch
// latent pixels, views do not see each other, nothing is propagated, and images are decoded by the autoencoder itself.
struct AutoencoderArchitecture : BackboneArchitecture {
  int64_t levels() const override { return 1; }
  int64_t leading_tokens() const override { return 0; }
  bool propagates() const override { return false; }
  int64_t blocks() const override { return 0; }
  bool attends_over_views(int64_t /*block*/) const override { return false; }
  Cost propagation_cost(const LatentGrid& /*grid*/, int64_t /*level*/) const override { return {}; }
  bool decodes_images() const override { return true; }
};

class Autoencoder : public Backbone {
 public:
  std::vector<DecodableLevel> propagate(const PropagationStart& start) const override;
  torch::Tensor normalise_for_decoding(const torch::Tensor& patches) const override { return patches; }
  // Views are decoded one by one, so that memory is that of one.
  torch::Tensor decode(const torch::Tensor& patches, const LatentGrid& grid) const override;

 protected:
  // Decodes the level's latents of a view, (1, channels, height, width), to its image, RGB in about [0, 1].
  virtual torch::Tensor decoded_view(const torch::Tensor& latents) const = 0;
};

}  // namespace gld
