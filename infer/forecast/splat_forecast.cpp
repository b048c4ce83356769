#include "infer/forecast/splat_forecast.h"

#include "datasets/splats/splat_picture.h"
#include "gld/base/philox.h"
#include "gld/kernels/kernel_table.h"
#include "gld/machine/timing.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <fmt/format.h>

namespace gld {
namespace {

// A wall whose distance changes by a tenth, in random grey, seen from places beside each other.
SplatPicture wall_picture(const SplatWork& work, int64_t view) {
  SplatPicture picture;
  picture.camera.width = work.width;
  picture.camera.height = work.height;
  const auto width = static_cast<double>(work.width);
  picture.camera.intrinsics << width, 0, width / 2, 0, width, static_cast<double>(work.height) / 2, 0, 0, 1;
  picture.camera.world_from_camera.translation() = Eigen::Vector3d(0.13 * static_cast<double>(view), 0, 0);
  picture.image = Image(work.width, work.height);
  picture.depth = DepthMap(work.width, work.height);
  const PhiloxKey key = philox_key(static_cast<uint64_t>(view), "splat forecast");
  for (int64_t y = 0; y < work.height; ++y) {
    for (int64_t x = 0; x < work.width; ++x) {
      const auto random = philox4x32({static_cast<uint32_t>(x), static_cast<uint32_t>(y), 0, 0}, key);
      std::fill_n(picture.image.pixel(x, y), 3, static_cast<uint8_t>(random[0] >> 24));
      picture.depth.at(x, y) =
          static_cast<float>(3 + 0.3 * std::sin(20 * static_cast<double>(x + y) / width));
    }
  }
  return picture;
}

int64_t padded(int64_t side) { return (side + kSplatTile - 1) / kSplatTile * kSplatTile; }

}  // namespace

SplatWork splat_work(const PlanRequest& request, int64_t patch_side, const SceneFitOptions& options) {
  const auto width = static_cast<double>(request.grid.width * patch_side),
             height = static_cast<double>(request.grid.height * patch_side);
  const double shrink = std::min(1.0, static_cast<double>(options.side) / std::max(width, height));
  SplatWork work;
  work.views = request.grid.views;
  work.width = std::max<int64_t>(1, std::lround(shrink * width));
  work.height = std::max<int64_t>(1, std::lround(shrink * height));
  work.gaussians = std::min(options.fit.density.most_gaussians, work.views * work.width * work.height);
  return work;
}

int64_t splat_fit_bytes(const SplatWork& work, const SplatFitOptions& options) {
  const int64_t pixels = work.views * work.width * work.height;
  const int64_t planes = work.views * padded(work.width) * work.height;
  // Bytes and depth, and the picture with its means and squares under SSIM's window.
  const int64_t pictures = pixels * (3 + 4 + 1) + planes * 3 * 3 * 4;
  // Before the first step: places, and their order by voxel twice while it is sorted anew.
  constexpr int64_t kSurfacePoint = 48, kVoxelled = 16;
  const int64_t start = pixels * (kSurfacePoint + 2 * kVoxelled + 8);
  const int64_t numbers = 14 + 3 * (harmonic_coefficients(options.degree) - 1);
  // Parameters, two moments, gradients; then the lists of a view and the sums of its tiles.
  const int64_t steps = work.gaussians * (4 * numbers * 4 + 3 * static_cast<int64_t>(sizeof(VisibleSplat)) +
                                          8 * (4 + 4 + 4 * (3 + kSplatMoments)));
  return pictures + std::max(start, steps);
}

double splat_fit_seconds(const SplatWork& work, const SplatFitOptions& options, int threads) {
  // What more views cost is start alone: a step looks at one.
  constexpr int64_t kViews = 6, kSteps = 5;
  KernelSettings settings;
  settings.threads = threads;
  const int64_t views = std::min(work.views, kViews);
  std::vector<SplatPicture> pictures;
  std::vector<FittedView> fitted;
  for (int64_t view = 0; view < views; ++view) {
    pictures.push_back(wall_picture(work, view));
    fitted.push_back(
        {"", pictures.back().camera, loss_target(splat_image_of(pictures.back().image), {}, settings), {}});
  }
  SplatFitOptions probe = options;
  probe.density.most_gaussians = std::max<int64_t>(1, work.gaussians);
  SplatFit fit;
  const double start = seconds_of([&] { fit = begin_splat_fit(pictures, {}, probe, "a wall"); });
  std::vector<double> seconds;
  for (int64_t step = 0; step < std::min(kSteps, options.steps); ++step)
    seconds.push_back(seconds_of([&] { splat_fit_step(fitted, probe, 0, settings, fit); }));
  const double all_start = start * static_cast<double>(work.views) / static_cast<double>(views);
  if (seconds.empty()) return all_start;
  std::sort(seconds.begin(), seconds.end());
  return all_start + static_cast<double>(options.steps) * seconds[seconds.size() / 2];
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
