#pragma once

#include "gld/cameras/camera.h"

#include <optional>
#include <string>
#include <vector>

#include <Eigen/Geometry>

namespace gld {

// Absolute trajectory error and relative pose errors as the tool evo defines them, after the similarity that brings the
// estimated centres onto the true ones best (Umeyama 1991: rotation, translation and scale from the centres alone).
struct TrajectoryErrors {
  std::string degenerate;  // why there are none, one phrase; empty where there are
  double ate = 0;          // root mean squared distance of the centres, in the truth's unit
  double ate_over_spread =
      0;  // over the root mean squared distance of the true centres from their mean: 0 to 1
  // Of the motion from each pose to the next: root mean squares, and means.
  double rpe_translation = 0;  // in the truth's unit
  double rpe_rotation = 0;     // degrees
  double rpe_translation_mean = 0;
  double rpe_rotation_mean = 0;
  double scale = 0;  // truth units in one of the estimate's
};

// Takes world_from_camera of the same views, in any frame and unit for the estimate. They are degenerate with fewer
// than 3 poses and where the centres of either stand at one place or on a line, which leave the rotation open (relative
// tolerance 1e-6). Throws Error unless there are as many of both.
TrajectoryErrors trajectory_errors(const std::vector<Eigen::Isometry3d>& truth,
                                   const std::vector<Eigen::Isometry3d>& estimate);

// Shares of the pairs of views whose relative poses agree, in percent, as GLD's release computes them: for i < j the
// angle between R_i R_j^T of both, and between the directions t_j - t_i. Both sides are seen from their own first view,
// because R_i R_j^T of world_from_camera depends on the frame.
struct PairAccuracy {
  // Area under the share of pairs whose larger error is below a threshold, up to 3 and 30 degrees: 0 to 100.
  double auc_3 = 0;
  double auc_30 = 0;
  double maa_30 = 0;        // mean of that share at 1, 2, ..., 30 degrees
  double rotation_15 = 0;   // pairs whose rotation is within 15 degrees
  double direction_15 = 0;  // pairs whose direction is
};

// One camera a view; only pairs of views from `first_view` on count. Nothing where there is no pair, or where two of
// the true cameras of a pair stand at one place, which leaves their direction open. A pair whose estimated cameras
// stand at one place counts as 180 degrees off.
std::optional<PairAccuracy> pair_accuracy(const std::vector<Camera>& truth,
                                          const std::vector<Camera>& estimate, int64_t first_view);

}  // namespace gld
