#pragma once

#include "gld/splatting/projection.h"
#include "gld/splatting/splat_view.h"

#include <cstdint>
#include <vector>

namespace gld {

// Features that depend on the direction from which a Gaussian is seen: f(d) = sum over k of b_k(d) f_k, where b_k are
// the real spherical harmonics over Y_0, so that b_0 is 1 and the mean of each b_k^2 over all directions as well. Of
// degree 0 they are features that do not depend on it.

// Returns the b of Gaussians from a camera, (splats of the view, coefficients), in the view's order.
std::vector<float> feature_harmonics(const GaussianSet& set, const SplatView& view, int64_t degree,
                                     const KernelSettings& settings);

// Returns what a view sees of features (gaussians, coefficients, channels): (splats of the view, channels), in the
// view's order.
std::vector<float> seen_features(const GaussianSet& set, const SplatView& view, const float* features,
                                 int64_t degree, int64_t channels, const KernelSettings& settings);

}  // namespace gld
