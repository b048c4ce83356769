#include "models/backbones/autoencoder.h"

#include "gld/latents/latent_tokens.h"

#include <vector>

#include <torch/types.h>

namespace gld {

std::vector<DecodableLevel> Autoencoder::propagate(const PropagationStart& start) const {
  require_level(start.level);
  require_propagation_tokens(start);
  return {decodable(start.tokens)};
}

torch::Tensor Autoencoder::decode(const torch::Tensor& patches, const LatentGrid& grid) const {
  require_propagation_tokens({0, patches, grid});
  const auto latents = latents_of_tokens(patches, grid, architecture().latent_pixels());
  std::vector<torch::Tensor> views;
  for (int64_t view = 0; view < latents.size(0); ++view) {
    views.push_back(decoded_view(latents.narrow(0, view, 1)));
  }
  return torch::cat(views);
}

}  // namespace gld
