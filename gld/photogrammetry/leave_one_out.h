#pragma once

#include "gld/kernels/attention_kernel.h"
#include "gld/photogrammetry/photo_consistency.h"
#include "gld/photogrammetry/plane_sweep_stereo.h"

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

namespace gld {

// What the other photographs predict of one that was taken: the same carrying that makes target views, where the truth
// is known.
struct LeftOutPhotograph {
  size_t view = 0;            // which was left out
  std::vector<size_t> from;   // what it was predicted from
  bool by_its_match = false;  // depth of the others is from their match with it: alone they told none
  bool depth_known =
      false;           // of any of the others; without it they show nothing of it, however much they overlap
  double covered = 0;  // share of its pixels that the others show
  // dB: of the prediction with gaps filled smoothly, of what is covered alone (not a number where nothing is), and of
  // what needs no depth: the photograph that was taken nearest, and the mean of the others.
  double psnr = 0;
  double psnr_covered = 0;
  double psnr_nearest = 0;
  double psnr_mean = 0;
  double expected = 0;  // dB that expected_variance() says of the prediction
};

struct LeaveOneOutOptions {
  int64_t photographs = 4;  // that are left out at most, chosen evenly
  int64_t neighbours = 4;   // that predict one at most: those that were taken nearest
  int64_t block = 1;  // pixels a side that are compared as one, by their mean: the size of what is generated
  StereoOptions stereo;
};

// Predicts photographs from the others under their cameras, with nothing generated: depth of the others alone, as
// stereo_depth() finds it, carries them into the camera of the one that is left out. Where the others tell no depth
// without it, one of two for example, their match with it does: then this is how far they fit each other. views have
// one size; their depth is a prior in the unit of the cameras, or empty, and serves as it is where photographs agree
// nowhere. Returns nothing of fewer than two views.
//
// Views that are left out lie farther from the others than most target views do: this is the lower end of what to
// expect. Throws Error as stereo_depth() does.
std::vector<LeftOutPhotograph> leave_one_out(const std::vector<PicturedView>& views,
                                             const std::vector<Eigen::Vector3d>& points,
                                             const LeaveOneOutOptions& options = {},
                                             const KernelSettings& settings = {});

// Returns the means over those left out; psnr_covered is over those of which something is covered, and not a number
// where none is; depth_known is whether it is of any. view and from are left empty.
LeftOutPhotograph mean_of(const std::vector<LeftOutPhotograph>& left_out);

}  // namespace gld
