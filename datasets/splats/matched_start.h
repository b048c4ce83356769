#pragma once

#include "datasets/splats/splat_start.h"
#include "gld/kernels/attention_kernel.h"

#include <vector>

#include <Eigen/Core>

namespace gld {

// Returns the pictures, smaller, with the depth that they agree on under their cameras (plane_sweep_stereo.h): only
// what is confident, nothing of a picture where no other was taken elsewhere. points bound the depths that are looked
// at.
std::vector<SplatPicture> with_matched_depth(const std::vector<SplatPicture>& pictures,
                                             const std::vector<Eigen::Vector3d>& points_in_world,
                                             const KernelSettings& settings);

}  // namespace gld
