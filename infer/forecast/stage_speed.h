#pragma once

#include "infer/forecast/sampling_plan.h"
#include "models/bundle/bundle_options.h"

namespace gld {

// Returns the seconds that a stage which runs once takes with this bundle's modules, random weights and random inputs
// of the request's size; 0 for a flow. The first run counts, as in the pipeline, where nothing is in caches. It costs
// about as much as the stage: for small models, whose time is in starting operations more than in computing.
double measure_stage_seconds(const SamplingStage& stage, const BundleOptions& bundle,
                             const PlanRequest& request);

}  // namespace gld
