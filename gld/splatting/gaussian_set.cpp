#include "gld/splatting/gaussian_set.h"

#include "gld/base/error.h"

#include <cmath>

#include <fmt/format.h>

namespace gld {

std::array<GaussianArray, kGaussianArrays> gaussian_arrays(const GaussianSet& set) {
  return {{{"mean", &GaussianSet::means, 3},
           {"log scale", &GaussianSet::log_scales, 3},
           {"rotation", &GaussianSet::rotations, 4},
           {"opacity", &GaussianSet::logit_opacities, 1},
           {"colour", &GaussianSet::colours, 3},
           {"spherical harmonic", &GaussianSet::harmonics, set.harmonics_each()},
           {"feature", &GaussianSet::features, set.channels}}};
}

GaussianSet zero_gaussians(int64_t count, int64_t degree) {
  GaussianSet shape;
  shape.degree = degree;
  return zero_gaussians_like(shape, count);
}

GaussianSet zero_gaussians_like(const GaussianSet& set, int64_t count) {
  GaussianSet zero;
  zero.origin = set.origin;
  zero.degree = set.degree;
  zero.channels = set.channels;
  for (const GaussianArray& array : gaussian_arrays(zero))
    (zero.*array.values).assign(static_cast<size_t>(count * array.each), 0.0F);
  return zero;
}

void check_gaussians(const GaussianSet& set, const std::string& where) {
  if (set.degree < 0 || set.degree > kMostHarmonicDegree) {
    fail({where, fmt::format("spherical harmonics of degree 0 to {}", kMostHarmonicDegree),
          fmt::format("degree {}", set.degree), "use another file"});
  }
  if (!set.origin.allFinite()) fail({where, "a finite origin", "one that is not", "check the cameras"});
  for (const GaussianArray& array : gaussian_arrays(set)) {
    const std::vector<float>& values = set.*array.values;
    if (static_cast<int64_t>(values.size()) != set.size() * array.each) {
      fail({where,
            fmt::format("{} numbers of {} for {} Gaussians", set.size() * array.each, array.name, set.size()),
            fmt::format("{}", values.size()), "make the set again"});
    }
    for (size_t i = 0; i < values.size(); ++i) {
      if (std::isfinite(values[i])) continue;
      fail({fmt::format("{}, Gaussian {}", where, i / static_cast<size_t>(array.each)),
            fmt::format("a finite {}", array.name), fmt::format("{}", values[i]),
            "leave it out or make it again"});
    }
  }
  for (int64_t i = 0; i < set.size(); ++i) {
    const float* q = set.rotations.data() + 4 * i;
    if (q[0] != 0 || q[1] != 0 || q[2] != 0 || q[3] != 0) continue;
    fail({fmt::format("{}, Gaussian {}", where, i), "a rotation as a quaternion that is not 0", "0, 0, 0, 0",
          "leave it out or make it again"});
  }
}

void append_gaussian(GaussianSet& set, const GaussianSet& from, int64_t i) {
  for (const GaussianArray& array : gaussian_arrays(set)) {
    const auto first = (from.*array.values).begin() + i * array.each;
    (set.*array.values).insert((set.*array.values).end(), first, first + array.each);
  }
}

GaussianSet kept_gaussians(const GaussianSet& set, const std::vector<uint8_t>& keep) {
  GaussianSet kept = zero_gaussians_like(set, 0);
  for (int64_t i = 0; i < set.size(); ++i) {
    if (keep[static_cast<size_t>(i)] != 0) append_gaussian(kept, set, i);
  }
  return kept;
}

}  // namespace gld
