#pragma once

#include "gld/splatting/gaussian_set.h"

#include <cstdint>

#include <Eigen/Core>
#include <nlohmann/json.hpp>

namespace gld {

// Returns 3D Gaussians as the page's script splats.js takes them apart and draws them: at most so many, those that
// cover most (opacity times the two longest axes). Each has its mean in 16 bits of the box around all, the logarithms
// of its axes in 8 bits of their range (at most 18 apart: shorter ones are lengthened), its rotation as a quaternion of
// 8 bits, its colour from all sides alike (coefficient 0) and its opacity in 8 bits. The object has {"count", "of",
// "low", "step", "scale_low", "scale_step", "bytes"}; low is less `origin`, which is the page's 0; bytes is base64 of
// deflated planes.
nlohmann::ordered_json page_splats(const GaussianSet& set, const Eigen::Vector3d& origin, int64_t most);

}  // namespace gld
