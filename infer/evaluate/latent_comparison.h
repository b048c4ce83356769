#pragma once

#include "gld/cameras/camera.h"
#include "infer/pipeline/sampling_pipeline.h"

#include <cstdint>
#include <map>
#include <vector>

#include <torch/types.h>

namespace gld {

// Latents by generated level, normalised: (views, special + patch tokens, channels).
using LevelLatents = std::map<int64_t, torch::Tensor>;

// Returns those of raw levels, level 0 to at least the deepest that is generated, as Backbone::encode gives them.
LevelLatents latents_of_levels(const PipelineModels& models, const std::vector<torch::Tensor>& raw,
                               const LatentGrid& grid);

// Returns the patch tokens of the target views as maps (targets, channels, rows, columns) on the CPU, as metrics take
// them. grid is of all views.
LevelLatents maps_of_targets(const LevelLatents& latents, const LatentGrid& grid, const Views& views);

}  // namespace gld
