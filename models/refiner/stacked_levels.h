#pragma once

#include "gld/cameras/camera.h"

#include <cstdint>
#include <vector>

#include <torch/types.h>

namespace gld {

// A refiner of samples repairs all levels that flows generate in one call: it sees their channels behind each other, a
// pixel a patch token (RefinerOptions::degraded, kGenerated).

// levels are latents in the order in which a model generates them, (views, special + patch tokens, C) each. Returns
// their patch tokens as maps, (views, levels C, height, width) of that grid's tokens.
torch::Tensor stacked_levels(const std::vector<torch::Tensor>& levels, const LatentGrid& grid);

// Does the inverse: returns the levels with these patch tokens from view `first` on, as many views as there are maps.
// Special tokens and the other views are as in `levels`.
std::vector<torch::Tensor> with_stacked_levels(const std::vector<torch::Tensor>& levels,
                                               const torch::Tensor& maps, int64_t first);

}  // namespace gld
