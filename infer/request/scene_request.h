#pragma once

#include "datasets/images/image.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "infer/request/sampling_scene.h"
#include "models/bundle/bundle_options.h"

#include <cstdint>
#include <vector>

#include <torch/types.h>

namespace gld {

// Makes of images of one size a tensor (images, 3, height, width) in [0, 1].
torch::Tensor stacked(const std::vector<Image>& images);

// Returns the views, source images and noise of a scene as the pipeline takes them. How the flows are solved and what
// is decoded is left to the caller.
PipelineRequest scene_request(const SamplingScene& scene, const BundleOptions& bundle, int64_t noise_seed,
                              const torch::Device& device);

}  // namespace gld
