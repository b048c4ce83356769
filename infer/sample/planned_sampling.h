#pragma once

#include "infer/forecast/method_choice.h"
#include "infer/forecast/sampling_plan.h"
#include "infer/method/sample_options.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "infer/sample/prepared_sampling.h"

#include <functional>
#include <string>

namespace gld {

// Where a plan's seconds come from: operations and the machine's kept or quickly estimated speed, or runs of the
// model's parts, which takes seconds.
enum class PlanTiming { kPredicted, kMeasured };

// The method and what it would take.
struct PlannedSampling {
  ChosenMethod choice;
  FlowSettings settings;
  SamplingPlan plan;
  KnownSpeed speed;  // that the plan's times come from
};

// model_hash is called where the bundle's measured errors are needed.
PlannedSampling plan_of(const PreparedSampling& prepared, const SampleOptions& options, PlanTiming timing,
                        const std::function<std::string()>& model_hash);

// Returns what the pipeline is asked for, all but its callbacks. The pixels are loaded (load_pixels).
PipelineRequest pipeline_request(const PreparedSampling& prepared, const SampleOptions& options,
                                 const FlowSettings& settings);

}  // namespace gld
