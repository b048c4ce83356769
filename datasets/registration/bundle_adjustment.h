#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace gld {

// Positions in pictures are from the middle, over the longer side. A point X in the camera is seen at
// focal_length (1 + k1 |p|^2) p with p = (X/Z, Y/Z).
struct BundleLens {
  double focal_length = 1;
  double k1 = 0;
  // What is known beforehand, as normal distributions: of log focal_length about log expected_focal_length, and of k1
  // about 0. A spread of 0 keeps the value as it is.
  double expected_focal_length = 1;
  double focal_length_spread = 0;
  double k1_spread = 0;
};

enum class BundleFreedom {
  kFree,
  kFixed,
  kUnit,  // free but for the largest component of its translation, which keeps the unit that nothing else keeps
};

struct BundleView {
  Eigen::Isometry3d camera_from_world = Eigen::Isometry3d::Identity();
  size_t lens = 0;
  double pixels = 1;  // a longer side, in which errors count
  BundleFreedom freedom = BundleFreedom::kFree;
};

struct BundleObservation {
  size_t view = 0;
  size_t point = 0;
  Eigen::Vector2d position = Eigen::Vector2d::Zero();
};

struct Bundle {
  std::vector<BundleLens> lenses;
  std::vector<BundleView> views;
  std::vector<Eigen::Vector3d> points_in_world;
  std::vector<BundleObservation> observations;
};

Eigen::Vector2d projected(const BundleLens& lens, const Eigen::Isometry3d& camera_from_world,
                          const Eigen::Vector3d& point_in_world);

enum class BundlePoints { kFree, kFixed };

// Moves views, points and lenses to the least sum of squared errors, robust against outliers (Cauchy beyond about a
// pixel), with Ceres. It runs in one thread, so that the result is the same every time. Lenses and points without an
// observation stay as they are. Returns the cost, in half squares of the spread of positions, priors included.
double adjust(Bundle& bundle, int most_iterations, BundlePoints points = BundlePoints::kFree);

}  // namespace gld
