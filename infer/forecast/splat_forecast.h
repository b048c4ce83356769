#pragma once

#include "datasets/splats/scene_fit.h"
#include "datasets/splats/splat_cost.h"
#include "infer/forecast/sampling_plan.h"

#include <cstdint>

namespace gld {

// This stage fits Gaussians to a run's pictures, in plans and records.
inline constexpr const char* kSplatStage = "splats";

SplatWork splat_work(const PlanRequest& request, int64_t patch_side, const SceneFitOptions& options);

// The request must have request.splats.
PlannedStage splat_stage(const PlanRequest& request, int64_t patch_side);
// Fills in the seconds of the plan's stage kSplatStage, where it has one.
void time_splat_stage(SamplingPlan& plan, const PlanRequest& request, int64_t patch_side, int threads);

}  // namespace gld
