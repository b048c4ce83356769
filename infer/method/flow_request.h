#pragma once

#include "infer/method/sampling_method.h"
#include "infer/pipeline/sampling_pipeline.h"

namespace gld {

// Has a request of scene_request (infer/pipeline/scene_request.h) solve its flows like this.
void use_flow_settings(PipelineRequest& request, const FlowSettings& settings);

// The prediction of the mean of what could be there: one evaluation of each flow from t = 1, without guidance. A
// regression, which PSNR rewards, and not a sample: neighbouring possibilities are averaged.
FlowSettings mean_prediction_settings(const BundleOptions& bundle);

}  // namespace gld
