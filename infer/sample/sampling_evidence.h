#pragma once

#include "infer/pipeline/sampling_pipeline.h"
#include "infer/sample/picture_verdict.h"
#include "infer/sample/prepared_sampling.h"

#include <optional>
#include <string>
#include <vector>

namespace gld {

// Returns what a sampling's verdict goes by, but for the photographs that are left out one at a time.
PictureEvidence sampling_evidence(const PreparedSampling& prepared, const PipelineResult& result);

// Returns each source photograph predicted from the others, as they are matched, with what the geometry head said of
// their depth.
std::vector<LeftOutPhotograph> left_out_photographs(const SamplingScene& scene, const PhotographUse& use,
                                                    const PipelineResult& result);

// That what was generated is unlike what the model was trained on, a sentence each; nothing where all target views come
// from photographs alone.
std::vector<std::string> doubts_of_generated(const PreparedSampling& prepared, const PipelineResult& result);

// Returns every doubt in a sentence: what the page says of the run too.
std::vector<std::string> doubts_of(const std::optional<PictureVerdict>& verdict,
                                   const PictureEvidence& evidence, const std::vector<std::string>& warnings);

}  // namespace gld
