#include "datasets/splats/splat_cost.h"

#include "datasets/splats/splat_picture.h"
#include "gld/base/error.h"
#include "gld/base/philox.h"
#include "gld/machine/timing.h"
#include "gld/photogrammetry/plane_sweep_stereo.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <fmt/format.h>

namespace gld {
namespace {

// Draws a wall whose distance changes by a tenth, in random grey, seen from places beside each other.
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

int64_t most_gaussians_of(const SplatWork& work, const SplatFitOptions& options) {
  if (settled_densification(options, work.start) == Densification::kPublished)
    return options.density.most_gaussians;
  return std::min(options.density.most_gaussians, work.views * work.width * work.height);
}

int64_t splat_fit_bytes(const SplatWork& work, const SplatFitOptions& options) {
  const int64_t pixels = work.views * work.width * work.height;
  const int64_t planes = (work.views + work.held_out) * padded(work.width) * work.height;
  // Bytes and depth, and the picture with its means and squares under SSIM's window.
  const int64_t pictures = pixels * (3 + 4 + 1) + planes * 3 * 3 * 4;
  // Before the first step there are places, and their order by voxel twice while it is sorted anew.
  constexpr int64_t kSurfacePoint = 48, kVoxelled = 16;
  // Pictures that are matched are floats, twice, beside the volumes of the match.
  const int64_t match =
      work.start == SplatStartFrom::kMatch ? pixels * 2 * 3 * 4 + (StereoOptions().memory_limit << 20) : 0;
  const int64_t start = std::max(match, pixels * (kSurfacePoint + 2 * kVoxelled + 8));
  const int64_t numbers = 14 + 3 * (harmonic_coefficients(options.degree) - 1);
  // Parameters, two moments, gradients; then the lists of a view, the records of its tiles and their sums.
  constexpr int64_t kRecords = 10, kRecord = static_cast<int64_t>(sizeof(SplatRow)) + 8 + 4 + 4;
  const int64_t steps = work.gaussians * (4 * numbers * 4 + 3 * static_cast<int64_t>(sizeof(VisibleSplat)) +
                                          kRecords * kRecord + 8 * (4 + 4 + 4 * (3 + kSplatMoments)));
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
  probe.start.from = SplatStartFrom::kDepth;  // which the wall has
  SplatFit fit;
  const double start = seconds_of([&] { fit = begin_splat_fit(pictures, {}, probe, "a wall", settings); });
  std::vector<double> seconds;
  for (int64_t step = 0; step < std::min(kSteps, options.steps); ++step)
    seconds.push_back(seconds_of([&] { splat_fit_step(fitted, probe, 0, settings, fit); }));
  const double all_start = start * static_cast<double>(work.views) / static_cast<double>(views);
  if (seconds.empty()) return all_start;
  std::sort(seconds.begin(), seconds.end());
  return all_start + static_cast<double>(options.steps) * seconds[seconds.size() / 2];
}

void require_memory_for_fit(const SplatWork& work, const SplatFitOptions& options, int64_t free_bytes,
                            const std::string& where) {
  constexpr double kGigabyte = 1e9;
  const int64_t needed = splat_fit_bytes(work, options);
  if (free_bytes <= 0 || needed <= free_bytes) return;
  fail({where,
        fmt::format("{:.1f} GB of memory for {} views of {}x{} and up to {} Gaussians",
                    static_cast<double>(needed) / kGigabyte, work.views, work.width, work.height,
                    work.gaussians),
        fmt::format("{:.1f} GB that are free", static_cast<double>(free_bytes) / kGigabyte),
        "make --side or --most-gaussians smaller, or the views fewer"});
}

}  // namespace gld
