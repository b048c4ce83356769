#pragma once

#include "gld/kernels/kernel_table.h"
#include "gld/photogrammetry/stereo_picture.h"

#include <cstdint>
#include <memory>
#include <vector>

namespace gld {

// Planes before a camera at inverse depths farthest, farthest + step, ..., 1 over the unit of its pose.
struct SweptPlanes {
  int64_t count = 0;
  double farthest = 0;
  double step = 0;

  double inverse_depth(double plane) const { return farthest + plane * step; }
};

// What each plane costs each pixel, (height, width, planes rounded up to kPlaneGroup).
struct CostVolume {
  int64_t width = 0;
  int64_t height = 0;
  int64_t planes = 0;
  int64_t stride = 0;  // planes, rounded up
  std::unique_ptr<uint8_t[]> costs;

  CostVolume(int64_t volume_width, int64_t volume_height, int64_t volume_planes);
  uint8_t* at(int64_t x, int64_t y) { return costs.get() + (y * width + x) * stride; }
  const uint8_t* at(int64_t x, int64_t y) const { return costs.get() + (y * width + x) * stride; }
};

// The windows of a photograph that others are correlated with.
struct ReferenceWindows {
  int64_t radius = 0;
  std::vector<float> mean;  // (height, width)
  std::vector<float>
      inverse_deviation;  // (height, width) 1 / sqrt(sum of squared deviations); 0 where not valid
  std::vector<float> share_of_columns;  // (width) 1 / columns of the window inside of the picture
  std::vector<float> share_of_rows;     // (height)

  ReferenceWindows(const StereoPicture& picture, int64_t window_radius);
};

// Noise of brightness as a share of a picture's largest difference from its mean: what has less contrast is not taken
// for texture. Half a step of 8 bits where a picture has all its range.
constexpr float kBrightnessNoise = 0.004F;

// One reference against the photographs it is compared with, at most kMostSweptPhotographs.
struct PlaneSweep {
  const StereoPicture* reference = nullptr;
  const ReferenceWindows* windows = nullptr;
  std::vector<const StereoPicture*> photographs;
  SweptPlanes planes;
};

// Fills rows [first_row, end_row) of the volume: kDearestMatch times 1 minus the mean correlation of the better half of
// the photographs that see the pixel on the plane, kUnseenMatch where none does. Windows reach over rows, so that
// few rows at a time cost more; calls for other rows may run at the same time.
void sweep_rows(const PlaneSweep& sweep, const KernelTable& kernels, int64_t first_row, int64_t end_row,
                CostVolume& volume);

// These return the floating-point operations and bytes of memory that sweep_rows needs for one plane, pixel and
// photograph, as the formulas count, for benchmarks.
double sweep_operations(int64_t window_radius);
double sweep_bytes();

}  // namespace gld
