#include "models/backbones/backbone_registry.h"
#include "models/weights/weight_loading.h"
#include "verify/reference_runners.h"

#include <string>

namespace gld {

// The case has an autoencoder and its image size: it is about what that makes of images, and of latents, in the tokens
// that a DiT sees.
NamedTensors run_autoencoder_case(const ReferenceCase& reference) {
  BackboneOptions options;
  reference.read_config(options);
  const auto autoencoder = options.make(reference.placement());
  load_strict(*autoencoder, reference.weight_file());
  reference.apply_precision(*autoencoder, ModelKind::kRunOnce);
  const auto images = reference.module_input("images", {-1, 3, -1, -1});
  const auto grid = options.grid_of(images.size(0), images.size(2), images.size(3));
  const auto tokens =
      reference.module_input("tokens", {grid.views, grid.tokens_per_view(), options.level_channels()});
  return {{"latent_tokens", autoencoder->encode(images, 0).front()},
          {"images", autoencoder->decode(tokens, grid)}};
}

}  // namespace gld
