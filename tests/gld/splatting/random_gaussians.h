#pragma once

#include "gld/cameras/camera.h"
#include "gld/splatting/gaussian_set.h"

#include <cmath>
#include <random>

namespace gld {

struct RandomGaussians {
  int64_t count = 20;
  int64_t degree = 0;
  double smallest = 0.05;  // standard deviations, before a camera that sees about 2 x 2 at their distance
  double largest = 0.4;
  unsigned seed = 1;
};

// They lie in a box around (0, 0, 4). Numbers are multiples of 2^-10, so that steps of 2^-10 are exact.
inline GaussianSet random_gaussians(const RandomGaussians& wanted) {
  std::mt19937 engine(wanted.seed);
  const auto uniform = [&](double low, double high) {
    const double value = std::uniform_real_distribution<double>(low, high)(engine);
    return static_cast<float>(std::round(value * 1024) / 1024);
  };
  GaussianSet set = zero_gaussians(wanted.count, wanted.degree);
  for (int64_t i = 0; i < wanted.count; ++i) {
    const auto at = static_cast<size_t>(i);
    for (size_t k = 0; k < 3; ++k) {
      set.means[3 * at + k] = uniform(-1, 1) + (k == 2 ? 4 : 0);
      set.log_scales[3 * at + k] = uniform(std::log(wanted.smallest), std::log(wanted.largest));
      set.colours[3 * at + k] = uniform(-1, 1.5);
    }
    for (size_t k = 0; k < 4; ++k) set.rotations[4 * at + k] = uniform(-1, 1);
    set.rotations[4 * at] += 1.5F;
    set.logit_opacities[at] = uniform(-2, 3);
  }
  for (float& value : set.harmonics) value = uniform(-0.2, 0.2);
  return set;
}

// The camera is turned and moved a little, with K off centre.
inline Camera splat_test_camera(int64_t width, int64_t height) {
  Camera camera;
  camera.width = width;
  camera.height = height;
  const auto w = static_cast<double>(width), h = static_cast<double>(height);
  camera.intrinsics << 1.7 * w, 0, 0.53 * w, 0, 1.6 * w, 0.46 * h, 0, 0, 1;
  camera.world_from_camera.linear() =
      (Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitY()) * Eigen::AngleAxisd(-0.07, Eigen::Vector3d::UnitZ()))
          .toRotationMatrix();
  camera.world_from_camera.translation() = Eigen::Vector3d(-0.4, 0.1, 0.2);
  return camera;
}

}  // namespace gld
