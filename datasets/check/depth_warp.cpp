#include "datasets/check/depth_warp.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace gld {
namespace {

// Returns bilinear depth at a pixel position; 0 next to the border, unknown pixels or an edge.
double depth_at(const DepthMap& depth, double x, double y) {
  const double u = x - 0.5;
  const double v = y - 0.5;
  const auto x0 = static_cast<int64_t>(std::floor(u));
  const auto y0 = static_cast<int64_t>(std::floor(v));
  if (x0 < 0 || y0 < 0 || x0 + 1 >= depth.width || y0 + 1 >= depth.height) return 0;
  const double corners[] = {depth.at(x0, y0), depth.at(x0 + 1, y0), depth.at(x0, y0 + 1),
                            depth.at(x0 + 1, y0 + 1)};
  const double low = *std::min_element(corners, corners + 4);
  const double high = *std::max_element(corners, corners + 4);
  if (low <= 0 || high > 1.1 * low) return 0;
  const double s = u - static_cast<double>(x0);
  const double t = v - static_cast<double>(y0);
  return (1 - t) * ((1 - s) * corners[0] + s * corners[1]) + t * ((1 - s) * corners[2] + s * corners[3]);
}

}  // namespace

WarpResult warp_depth(const DepthView& a, const DepthView& b, double relative_tolerance) {
  const Eigen::Matrix3d ray_from_pixel = a.camera.intrinsics.inverse();
  const Eigen::Isometry3d b_from_a = b.camera.world_from_camera.inverse() * a.camera.world_from_camera;
  int64_t known = 0;
  int64_t in_view = 0;
  std::vector<double> errors;
  for (int64_t y = 0; y < a.depth.height; ++y) {
    for (int64_t x = 0; x < a.depth.width; ++x) {
      if (a.depth.at(x, y) <= 0) continue;
      ++known;
      const Eigen::Vector3d pixel(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5, 1);
      const Eigen::Vector3d in_b = b_from_a * (ray_from_pixel * pixel * a.depth.at(x, y));
      if (in_b.z() <= 0) continue;
      const Eigen::Vector2d position = (b.camera.intrinsics * in_b).hnormalized();
      const double there = depth_at(b.depth, position.x(), position.y());
      if (there <= 0) continue;
      ++in_view;
      const double error = std::abs(in_b.z() - there) / in_b.z();
      if (error < relative_tolerance) errors.push_back(error);
    }
  }
  WarpResult result;
  if (known > 0) result.share_in_view = static_cast<double>(in_view) / static_cast<double>(known);
  if (errors.empty()) return result;
  result.share_agreeing = static_cast<double>(errors.size()) / static_cast<double>(in_view);
  std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2),
                   errors.end());
  result.median_error = errors[errors.size() / 2];
  return result;
}

}  // namespace gld
