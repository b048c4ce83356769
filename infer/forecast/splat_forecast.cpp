#include "infer/forecast/splat_forecast.h"

#include "datasets/splats/splat_start.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

namespace gld {

SplatWork splat_work(const PlanRequest& request, int64_t patch_side, const SceneFitOptions& options) {
  const int64_t side = request.picture_magnification * patch_side;
  const auto width = static_cast<double>(request.grid.width * side),
             height = static_cast<double>(request.grid.height * side);
  const double shrink = std::min(1.0, static_cast<double>(options.side) / std::max(width, height));
  SplatWork work;
  work.views = request.grid.views;
  work.width = std::max<int64_t>(1, std::lround(shrink * width));
  work.height = std::max<int64_t>(1, std::lround(shrink * height));
  work.start = settled_start(options.fit.start.from, /*has_depth=*/true, /*has_points=*/false);
  work.gaussians = most_gaussians_of(work, options.fit);
  return work;
}

PlannedStage splat_stage(const PlanRequest& request, int64_t patch_side) {
  const SceneFitOptions& options = *request.splats;
  const SplatWork work = splat_work(request, patch_side, options);
  PlannedStage stage;
  stage.kind = StageKind::kGeometry;
  stage.name = kSplatStage;
  stage.of_products = false;
  stage.precision = layer_precision(ComputePrecision::kFloat32, ModelKind::kLeanedOn);
  stage.evaluations = options.fit.steps;
  stage.reason = fmt::format("{} steps, {} views of {}x{}, at most {} Gaussians", options.fit.steps,
                             work.views, work.width, work.height, work.gaussians);
  stage.memory.held = splat_fit_bytes(work, options.fit);
  stage.peak_bytes = predicted_peak_bytes(stage.memory);
  return stage;
}

void time_splat_stage(SamplingPlan& plan, const PlanRequest& request, int64_t patch_side, int threads) {
  for (PlannedStage& stage : plan.stages) {
    if (stage.name != kSplatStage || !request.splats) continue;
    stage.seconds =
        splat_fit_seconds(splat_work(request, patch_side, *request.splats), request.splats->fit, threads);
  }
}

}  // namespace gld
