#pragma once

#include "gld/cameras/camera.h"

#include <cstdint>

#include <torch/types.h>

namespace gld {

// Returns a map of latents as the tokens that a DiT of patch size p sees: a token is a block of p x p latent pixels,
// its channels are ordered (channel, row in the block, column in the block), as a p x p patch embedding's weights are.
// The DiT itself then has patch size 1 and p^2 times the latent's channels, which is the same network. The shape goes
// from (views, channels, height, width) to (views, height/p * width/p, channels p^2).
torch::Tensor tokens_of_latents(const torch::Tensor& latents, int64_t patch);
// The inverse; grid is that of the tokens.
torch::Tensor latents_of_tokens(const torch::Tensor& tokens, const LatentGrid& grid, int64_t patch);

}  // namespace gld
