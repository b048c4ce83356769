#include "gld/splatting/gaussian_set.h"

#include "tests/gld/splatting/random_gaussians.h"
#include "tests/support/error_of.h"

#include <algorithm>
#include <limits>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;

TEST(GaussianSet, WhatIsNoNumberIsNamed) {
  const float nan = std::numeric_limits<float>::quiet_NaN(),
              infinite = std::numeric_limits<float>::infinity();
  GaussianSet set = random_gaussians({});
  set.log_scales[3 * 7 + 1] = nan;
  EXPECT_EQ(error_of([&] { check_gaussians(set, "splats.ply"); }),
            "splats.ply, Gaussian 7: expected a finite log scale, found nan; leave it out or make it again.");
  set = random_gaussians({});
  set.means[3 * 19] = infinite;
  EXPECT_EQ(error_of([&] { check_gaussians(set, "splats.ply"); }),
            "splats.ply, Gaussian 19: expected a finite mean, found inf; leave it out or make it again.");
  set = random_gaussians({});
  std::fill_n(set.rotations.begin() + 4, 4, 0.0F);
  EXPECT_EQ(
      error_of([&] { check_gaussians(set, "splats.ply"); }),
      "splats.ply, Gaussian 1: expected a rotation as a quaternion that is not 0, found 0, 0, 0, 0; leave it out "
      "or make it again.");
}

}  // namespace
}  // namespace gld
