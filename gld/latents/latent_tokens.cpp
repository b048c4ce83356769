#include "gld/latents/latent_tokens.h"

namespace gld {

torch::Tensor tokens_of_latents(const torch::Tensor& latents, int64_t patch) {
  const int64_t views = latents.size(0), channels = latents.size(1);
  const int64_t rows = latents.size(2) / patch, columns = latents.size(3) / patch;
  return latents.reshape({views, channels, rows, patch, columns, patch})
      .permute({0, 2, 4, 1, 3, 5})
      .reshape({views, rows * columns, channels * patch * patch});
}

torch::Tensor latents_of_tokens(const torch::Tensor& tokens, const LatentGrid& grid, int64_t patch) {
  const int64_t channels = tokens.size(2) / (patch * patch);
  return tokens.reshape({grid.views, grid.height, grid.width, channels, patch, patch})
      .permute({0, 3, 1, 4, 2, 5})
      .reshape({grid.views, channels, grid.height * patch, grid.width * patch});
}

}  // namespace gld
