#pragma once

#include "datasets/scenes/scene.h"
#include "gld/report/table.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

struct SplatSpeedSettings {
  int64_t gaussians = 20000;
  std::vector<int64_t> channels{4, 64};
  int64_t side = 64;           // of pictures with channels
  int64_t picture_side = 256;  // of the step of a fit to pictures
  int64_t repeats = 7;
  int64_t dense_repeats = 1;  // of LibTorch's, which takes seconds
  int threads = 1;
};

// pass is "lists" (projection, sorting, lists of tiles), "forward" (that and compositing), "backward" (gradients of
// features, places, covariances and opacities), "backward_features" (of features alone, as where geometry is fixed), or
// "step" (all of a step of a fit in colours: forward, loss, backward to every parameter, Adam; LibTorch's is
// compositing forward and backward alone).
struct SplatSpeedRow {
  std::string pass;
  int64_t side = 0;      // pixels
  int64_t channels = 0;  // 3: colours
  int64_t seen = 0;      // Gaussians of the view
  int64_t threads = 0;
  double milliseconds = 0;  // median
  double milliseconds_low = 0, milliseconds_high = 0;
  double dense_milliseconds = 0;  // median of LibTorch's dense rendering in the same run; 0: has no such pass
  double times = 0;               // dense / ours
  // Root mean square over that of the result in double (naive_splatting.h), which for gradients is that of features; 0
  // where nothing was compared.
  double error = 0, dense_error = 0;
};
// The rows are of Gaussians put on the surfaces of a scene with depth, as a fit begins, in the view that shows most of
// them.
std::vector<SplatSpeedRow> splat_speed_rows(const Scene& scene, const SplatSpeedSettings& settings);
Table splat_speed_table(const std::vector<SplatSpeedRow>& rows);

}  // namespace gld
