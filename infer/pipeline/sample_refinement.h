#pragma once

#include "infer/pipeline/pipeline_state.h"
#include "infer/pipeline/sampling_pipeline.h"

#include <string>

namespace gld {

// Repairs the target views' generated latents, each in one call beside the exact latents of the source views nearest to
// it, in the state and in the result (Splatent's refiner, arXiv 2512.09923, on samples of few evaluations). Throws
// Error naming the stage where a number is not finite.
void run_sample_refinement(const PipelineModels& models, const PipelineRequest& request,
                           const std::string& stage, PipelineState& state, PipelineResult& result);

}  // namespace gld
