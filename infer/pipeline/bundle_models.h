#pragma once

#include "infer/pipeline/photograph_use.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "models/bundle/bundle.h"
#include "models/layers/layer_precision.h"

#include <torch/types.h>

namespace gld {

// Returns the modules of a bundle, each loaded from its file when the pipeline asks for it. bundle is copied. On the
// CPU their weights are packed for that precision and not kept beside (models/layers/layer_precision.h); float32
// computes the same bits as weights that are packed whenever they are used.
PipelineModels bundle_models(const ModelBundle& bundle, const torch::Device& device,
                             ComputePrecision precision = ComputePrecision::kFloat32);

// Returns the same, but every stage's module is loaded once and kept, for commands that run the same models on many
// scenes. It is not for several threads at once.
PipelineModels kept_bundle_models(const ModelBundle& bundle, const torch::Device& device,
                                  ComputePrecision precision = ComputePrecision::kFloat32);

// Returns what options make of the photographs with that bundle.
PhotographUse photograph_use_of(const PhotographOptions& options, const ModelBundle& bundle);

// Throws Error, naming --geometry-model, where a bundle has no geometry head.
void require_geometry_head(const ModelBundle& bundle);
// Depth and rays then come from that bundle, which looks at the generated images. Throws Error where it has no geometry
// head.
void take_geometry_from(PipelineModels& models, const ModelBundle& bundle, const torch::Device& device);

}  // namespace gld
