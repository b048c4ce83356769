#pragma once

#include "datasets/splats/scene_fit.h"
#include "infer/forecast/sampling_plan.h"

#include <cstdint>

namespace gld {

// The stage that fits Gaussians to a run's pictures, in plans and records.
inline constexpr const char* kSplatStage = "splats";

// What such a fit works on.
struct SplatWork {
  int64_t views = 0;
  int64_t width = 0, height = 0;  // of a picture that is fitted
  int64_t gaussians = 0;          // at most: one a pixel and view, under the cap
};
SplatWork splat_work(const PlanRequest& request, int64_t patch_side, const SceneFitOptions& options);

// Bytes of pictures, surface points, parameters with their moments and gradients, and lists of a view.
int64_t splat_fit_bytes(const SplatWork& work, const SplatFitOptions& options);

// Splatting's speed has little to do with that of matrix products: some steps of a fit of this size are run, on a wavy
// wall with random colours, in some tenths of a second. Seconds of the whole fit, start included.
double splat_fit_seconds(const SplatWork& work, const SplatFitOptions& options, int threads);

// request.splats is there.
PlannedStage splat_stage(const PlanRequest& request, int64_t patch_side);
// Fills in the seconds of the plan's stage kSplatStage, where it has one.
void time_splat_stage(SamplingPlan& plan, const PlanRequest& request, int64_t patch_side, int threads);

}  // namespace gld
