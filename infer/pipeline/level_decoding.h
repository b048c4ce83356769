#pragma once

#include "infer/pipeline/pipeline_state.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "models/latent_spaces/latent_space.h"

#include <cstdint>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// These functions lead from generated latents to what decoders take, and to images. Each function throws Error naming
// the stage where a number is not finite.

// what is for example "images".
void require_finite(const torch::Tensor& tensor, const std::string& stage, const std::string& what);

// Returns all levels of all views from the latents of the generated ones, of which none may be missing.
CompletedLevels complete_levels(const PipelineModels& models, const PipelineState& state,
                                const LatentGrid& grid, const std::string& stage);

// The views to decode: their levels by number, and their grid.
struct DecodableViews {
  std::vector<torch::Tensor> levels;
  LatentGrid grid;
};
DecodableViews select_views(const std::vector<torch::Tensor>& levels, const LatentGrid& grid,
                            DecodedViews which, int64_t num_sources);

// The images are (views, 3, height, width) on the CPU, not clamped.
torch::Tensor decoded_images(const PipelineModels& models, const DecodableViews& views,
                             const std::string& stage);

}  // namespace gld
