#pragma once

#include <Eigen/Core>

namespace gld {

enum class LensModel {
  kNone,              // an ideal pinhole
  kRadialTangential,  // OpenCV: k1..k6 (rational), p1, p2
  kFisheye,           // OpenCV fisheye: k1..k4 of the angle
  kThinPrismFisheye,  // COLMAP and ETH3D: fisheye angle, then k1..k4 radial, p1, p2 tangential, sx1, sy1 prism
};

struct LensDistortion {
  LensModel model = LensModel::kNone;
  double k1 = 0, k2 = 0, k3 = 0, k4 = 0, k5 = 0, k6 = 0;
  double p1 = 0, p2 = 0;
  double sx1 = 0, sy1 = 0;

  // Returns true when the lens changes nothing.
  bool ideal() const;
  bool finite() const;
};

// Returns where the lens puts the ray (x, y, 1): both are in normalised image coordinates, (pixel - principal point) /
// focal.
Eigen::Vector2d distorted(const LensDistortion& lens, const Eigen::Vector2d& ideal_point);

// Returns the largest radius up to which the distorted radius grows. Beyond it a polynomial folds back and maps points
// into the image that no ray reaches. It is at most 100.
double largest_ideal_radius(const LensDistortion& lens);

}  // namespace gld
