#pragma once

#include "gld/kernels/kernel_table.h"
#include "gld/photogrammetry/plane_sweep.h"
#include "gld/photogrammetry/stereo_picture.h"

#include <cstdint>
#include <vector>

namespace gld {

// What a change of plane from one pixel to the next costs, in units in which correlation 0 instead of 1 costs 1.
struct PathPenalties {
  double small_step = 0.04;  // one plane: slanted surfaces
  double big_step = 0.3;     // more, where both pixels are equally bright
  double least_big_step = 0.08;
  double edge =
      0.25;  // difference of brightness at which a big step costs half, in root mean squares of the picture
};

// The plane that semi-global matching gives each pixel, (height, width).
struct MatchedPlanes {
  std::vector<float> plane;   // between planes, by the parabola through the three sums about the least
  std::vector<uint8_t> cost;  // in the volume, of the plane nearest to it
  std::vector<float>
      uniqueness;  // by how much the second best is dearer, for each path, correlation 0 costs 1
};

// Hirschmueller, "Stereo Processing by Semiglobal Matching and Mutual Information", PAMI 2008, with eight paths: the
// four that come from above and the left in one pass down, the others in one pass up. Planes within one_minimum of the
// best are no second one.
MatchedPlanes match_semi_globally(const CostVolume& volume, const StereoPicture& picture,
                                  const PathPenalties& penalties, int64_t one_minimum,
                                  const KernelTable& kernels);

// Returns the operations on 16 bits for each plane and pixel, as the formulas count, for benchmarks.
double semi_global_operations();
// Returns the bytes that they read and write for it.
double semi_global_traffic();

}  // namespace gld
