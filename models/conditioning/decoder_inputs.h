#pragma once

#include "models/decoders/geometry_head.h"
#include "models/latent_spaces/latent_space.h"

#include <cstdint>
#include <vector>

#include <torch/types.h>

namespace gld {

// Returns what the geometry head takes of views by themselves: all raw levels of them, (views, leading + patch tokens,
// C).
GeometryInputs geometry_inputs(const LatentSpace& space, const std::vector<torch::Tensor>& raw_levels);

// Returns what an image decoder takes, (views, patch tokens, C of all those levels): the levels that it decodes, of
// which those that are undefined are zeros, as it knows them from its level dropout. levels are by number, as decoders
// take them. Throws Error where none of them is there.
torch::Tensor image_features(const std::vector<torch::Tensor>& levels, const std::vector<int64_t>& decoded);

}  // namespace gld
