#include "gld/photogrammetry/published_pose_from_rays.h"

#include "gld/base/error.h"
#include "gld/base/mixed_bits.h"
#include "gld/cameras/nearest_rotation.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <string>
#include <utility>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/QR>

namespace gld {
namespace {

constexpr int kDraws = 100;
constexpr size_t kPointsADraw = 8;
constexpr double kSurestToDraw = 0.3;
constexpr double kSurestToRefit = 0.95;
constexpr size_t kMostToRefit = 8000;
constexpr double kInlierDistance = 0.2;  // in the plane at distance 1
constexpr double kSmallestZ = 1e-4;
constexpr int64_t kLinearStep = 4;  // cells

[[noreturn]] void fail_for_view(size_t view, const std::string& found) {
  fail({"poses from rays, view " + std::to_string(view), "rays that a camera fits", found,
        "choose another estimator of poses, or none"});
}

// A point of the plane of a camera with focal length 1 and the direction that belongs to it, in the plane z = 1.
struct PlanePair {
  Eigen::Vector2d from;
  Eigen::Vector2d to;
  double weight = 0;
};

std::vector<PlanePair> plane_pairs(const RayGrid& grid) {
  std::vector<PlanePair> pairs;
  for (int64_t row = 0; row < grid.height; ++row) {
    for (int64_t column = 0; column < grid.width; ++column) {
      const auto cell = static_cast<size_t>(row * grid.width + column);
      const Eigen::Vector3d& direction = grid.directions[cell];
      if (!(grid.confidence[cell] > 0) || std::abs(direction.z()) <= kSmallestZ) continue;
      pairs.push_back({{(2 * static_cast<double>(column) + 1) / static_cast<double>(grid.width) - 1,
                        (2 * static_cast<double>(row) + 1) / static_cast<double>(grid.height) - 1},
                       direction.head<2>() / direction.z(),
                       grid.confidence[cell]});
    }
  }
  // The surest comes first, and of equals the earlier cell.
  std::stable_sort(pairs.begin(), pairs.end(),
                   [](const PlanePair& a, const PlanePair& b) { return a.weight > b.weight; });
  return pairs;
}

// The direct linear transform, each equation times the square root of its weight: the eigenvector of the least
// eigenvalue of the normal equations is the least right singular vector.
Eigen::Matrix3d homography(const std::vector<PlanePair>& pairs) {
  Eigen::Matrix<double, 9, 9> normal = Eigen::Matrix<double, 9, 9>::Zero();
  for (const PlanePair& pair : pairs) {
    const Eigen::Vector3d from = pair.from.homogeneous();
    Eigen::Matrix<double, 2, 9> rows = Eigen::Matrix<double, 2, 9>::Zero();
    rows.block<1, 3>(0, 0) = -from.transpose();
    rows.block<1, 3>(0, 6) = pair.to.x() * from.transpose();
    rows.block<1, 3>(1, 3) = -from.transpose();
    rows.block<1, 3>(1, 6) = pair.to.y() * from.transpose();
    normal += pair.weight * rows.transpose() * rows;
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 9, 9>> solver(normal);
  const Eigen::Matrix<double, 9, 1> h = solver.eigenvectors().col(0);
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(h.data());
}

bool is_inlier(const Eigen::Matrix3d& h, const PlanePair& pair) {
  const Eigen::Vector3d mapped = h * pair.from.homogeneous();
  return (mapped.hnormalized() - pair.to).norm() < kInlierDistance;
}

Eigen::Matrix3d robust_homography(const std::vector<PlanePair>& pairs, size_t view) {
  const auto drawn_from = static_cast<size_t>(kSurestToDraw * static_cast<double>(pairs.size()));
  if (drawn_from < kPointsADraw) {
    fail_for_view(view, std::to_string(pairs.size()) + " usable rays");
  }
  double best_score = -1;
  Eigen::Matrix3d best = Eigen::Matrix3d::Zero();
  uint64_t random = 0;
  for (int draw = 0; draw < kDraws; ++draw) {
    std::vector<PlanePair> chosen;
    std::vector<size_t> taken;
    while (chosen.size() < kPointsADraw) {
      const size_t place = mixed_bits(random++) % drawn_from;
      if (std::find(taken.begin(), taken.end(), place) != taken.end()) continue;
      taken.push_back(place);
      chosen.push_back(pairs[place]);
    }
    const Eigen::Matrix3d h = homography(chosen);
    double score = 0;
    for (const PlanePair& pair : pairs) score += is_inlier(h, pair) ? pair.weight : 0;
    if (score > best_score) {
      best_score = score;
      best = h;
    }
  }
  std::vector<PlanePair> inliers;
  const auto surest = static_cast<size_t>(kSurestToRefit * static_cast<double>(pairs.size()));
  for (size_t i = 0; i < surest; ++i) {
    if (is_inlier(best, pairs[i])) inliers.push_back(pairs[i]);
  }
  if (inliers.size() < kPointsADraw) fail_for_view(view, std::to_string(inliers.size()) + " inliers");
  if (inliers.size() > kMostToRefit) {
    std::vector<PlanePair> some;
    for (size_t i = 0; i < kMostToRefit; ++i) some.push_back(inliers[i * inliers.size() / kMostToRefit]);
    inliers = std::move(some);
  }
  return homography(inliers);
}

// H = rotation * lower, where the diagonal of lower is positive.
struct RotationAndLower {
  Eigen::Matrix3d rotation;
  Eigen::Matrix3d lower;
};

RotationAndLower ql_decomposition(const Eigen::Matrix3d& h) {
  const Eigen::Matrix3d reversed = h.rowwise().reverse();
  const Eigen::HouseholderQR<Eigen::Matrix3d> qr(reversed);
  const Eigen::Matrix3d q = qr.householderQ();
  const Eigen::Matrix3d r = qr.matrixQR().triangularView<Eigen::Upper>();
  RotationAndLower parts{q.rowwise().reverse(), r.reverse()};
  for (int i = 0; i < 3; ++i) {
    if (parts.lower(i, i) >= 0) continue;
    parts.lower.row(i) *= -1;
    parts.rotation.col(i) *= -1;
  }
  return parts;
}

Eigen::Vector3d mean_origin(const RayGrid& grid, size_t view) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double weights = 0;
  for (size_t cell = 0; cell < grid.origins.size(); ++cell) {
    if (!(grid.confidence[cell] > 0)) continue;
    sum += grid.confidence[cell] * grid.origins[cell];
    weights += grid.confidence[cell];
  }
  if (!(weights > 0)) fail_for_view(view, "no usable ray");
  return sum / weights;
}

void require_finite(const Camera& camera, size_t view) {
  if (camera.intrinsics.allFinite() && camera.world_from_camera.matrix().allFinite() &&
      camera.intrinsics(0, 0) > 0 && camera.intrinsics(1, 1) > 0) {
    return;
  }
  fail_for_view(view, "a fit that is no camera");
}

Eigen::Matrix3d linear_fit(const RayGrid& grid, size_t view) {
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero(), products = Eigen::Matrix3d::Zero();
  for (int64_t row = 0; row < grid.height; row += kLinearStep) {
    for (int64_t column = 0; column < grid.width; column += kLinearStep) {
      const auto cell = static_cast<size_t>(row * grid.width + column);
      const double weight = grid.confidence[cell] * grid.confidence[cell];
      if (!(weight > 0)) continue;
      const Eigen::Vector3d pixel(static_cast<double>(column), static_cast<double>(row), 1);
      normal += weight * pixel * pixel.transpose();
      products += weight * grid.directions[cell] * pixel.transpose();
    }
  }
  const Eigen::FullPivLU<Eigen::Matrix3d> lu(normal);
  if (!lu.isInvertible()) fail_for_view(view, "rays that do not spread");
  return products * lu.inverse();
}

}  // namespace

RayGrid ray_grid(const RayMap& rays, const ConfidenceMap& confidence) {
  RayGrid grid;
  grid.width = rays.width;
  grid.height = rays.height;
  if (!confidence.empty() && (confidence.width != rays.width || confidence.height != rays.height)) {
    fail({"poses from rays", "a confidence for each ray",
          std::to_string(confidence.width) + "x" + std::to_string(confidence.height) + " for " +
              std::to_string(rays.width) + "x" + std::to_string(rays.height),
          "predict both at one size"});
  }
  for (int64_t y = 0; y < rays.height; ++y) {
    for (int64_t x = 0; x < rays.width; ++x) {
      const float* ray = rays.ray(x, y);
      double weight = confidence.empty() ? 1 : confidence.at(x, y);
      const bool finite = std::all_of(ray, ray + 6, [](float value) { return std::isfinite(value); });
      if (!finite || !std::isfinite(weight)) weight = 0;
      const Eigen::Vector3f direction(ray), origin(ray + 3);
      grid.directions.push_back(finite ? Eigen::Vector3d(direction.cast<double>()) : Eigen::Vector3d::Zero());
      grid.origins.push_back(finite ? Eigen::Vector3d(origin.cast<double>()) : Eigen::Vector3d::Zero());
      grid.confidence.push_back(std::max(weight, 0.0));
    }
  }
  return grid;
}

std::vector<Camera> cameras_from_rays_da3(const std::vector<RayGrid>& views, const ImageSize& size) {
  std::vector<Camera> cameras;
  const auto half_width = static_cast<double>(size.width) / 2,
             half_height = static_cast<double>(size.height) / 2;
  for (size_t view = 0; view < views.size(); ++view) {
    Eigen::Matrix3d h = robust_homography(plane_pairs(views[view]), view);
    if (h.determinant() < 0) h = -h;
    const RotationAndLower parts = ql_decomposition(h);
    const Eigen::Matrix3d lower = parts.lower / parts.lower(2, 2);
    Camera camera;
    camera.width = size.width;
    camera.height = size.height;
    camera.intrinsics << half_width / lower(0, 0), 0, half_width * (lower(2, 0) + 1), 0,
        half_height / lower(1, 1), half_height * (lower(2, 1) + 1), 0, 0, 1;
    camera.world_from_camera.linear() = parts.rotation;
    camera.world_from_camera.translation() = mean_origin(views[view], view);
    require_finite(camera, view);
    cameras.push_back(camera);
  }
  return cameras;
}

std::vector<Camera> cameras_from_rays_gld(const std::vector<RayGrid>& views, const ImageSize& size) {
  if (views.empty()) return {};
  const Eigen::Matrix3d first_inverse = linear_fit(views.front(), 0).inverse();
  if (!first_inverse.allFinite()) fail_for_view(0, "rays that do not spread");
  Eigen::Matrix3d intrinsics = first_inverse / first_inverse(2, 2);
  intrinsics.row(0) *= static_cast<double>(size.width) / static_cast<double>(views.front().width);
  intrinsics.row(1) *= static_cast<double>(size.height) / static_cast<double>(views.front().height);
  std::vector<Camera> cameras;
  for (size_t view = 0; view < views.size(); ++view) {
    Camera camera;
    camera.width = size.width;
    camera.height = size.height;
    camera.intrinsics = intrinsics;
    camera.world_from_camera.linear() = nearest_rotation(linear_fit(views[view], view) * first_inverse);
    camera.world_from_camera.translation() = mean_origin(views[view], view);
    require_finite(camera, view);
    cameras.push_back(camera);
  }
  return cameras;
}

}  // namespace gld
