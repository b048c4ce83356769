#pragma once

#include "gld/cameras/camera.h"
#include "infer/pipeline/photograph_use.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "models/decoders/geometry_head.h"
#include "models/scene_geometry/photograph_depth.h"

#include <torch/types.h>

namespace gld {

// Returns the depth of the source views by which a run that makes this use of photographs carries and keeps them, with
// the model's own network where that mends it. head is what the geometry head says of the source views alone; it is
// null where it is not asked. single_source_unit is as source_depth_of_head() takes it.
PhotographDepth used_source_depth(const PipelineModels& models, const PhotographUse& use, const Views& views,
                                  const torch::Tensor& source_images, const SourcePhotographs& photographs,
                                  const GeometryOutput* head, double single_source_unit);

}  // namespace gld
