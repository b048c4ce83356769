#include "gld/cameras/convex_piece.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>

namespace gld {
namespace {

// Gaps smaller than this share of the coordinates are rounding, and the solids count as touching.
constexpr double kRounding = 1e-12;
// Cross products of edges shorter than this are of parallel edges and say nothing the face normals do not.
constexpr double kParallel = 1e-9;

bool separates(const Eigen::Vector3d& axis, const ConvexPiece& a, const ConvexPiece& b) {
  double low_a = axis.dot(a.corners[0]), high_a = low_a;
  double low_b = axis.dot(b.corners[0]), high_b = low_b;
  for (size_t i = 1; i < a.corners.size(); ++i) {
    const double at_a = axis.dot(a.corners[i]), at_b = axis.dot(b.corners[i]);
    low_a = std::min(low_a, at_a);
    high_a = std::max(high_a, at_a);
    low_b = std::min(low_b, at_b);
    high_b = std::max(high_b, at_b);
  }
  const double rounding = kRounding * std::max(a.largest, b.largest);
  return high_a + rounding < low_b || high_b + rounding < low_a;
}

}  // namespace

ConvexPiece frustum_piece(const Camera& camera, const FrustumPart& part) {
  const Eigen::Matrix3d& k = camera.intrinsics;
  const Eigen::Matrix3d rotation = camera.world_from_camera.linear();
  const Eigen::Vector3d centre = camera.world_from_camera.translation();
  const auto width = static_cast<double>(camera.width), height = static_cast<double>(camera.height);
  const double columns[2] = {(part.left * width - k(0, 2)) / k(0, 0),
                             (part.right * width - k(0, 2)) / k(0, 0)};
  const double rows[2] = {(part.top * height - k(1, 2)) / k(1, 1),
                          (part.bottom * height - k(1, 2)) / k(1, 1)};
  ConvexPiece piece;
  piece.edges[0] = rotation.col(0);
  piece.edges[1] = rotation.col(1);
  piece.normals[0] = rotation.col(2);
  for (size_t side = 0; side < 2; ++side) {
    piece.normals[1 + side] = rotation * Eigen::Vector3d(1, 0, -columns[side]).normalized();
    piece.normals[3 + side] = rotation * Eigen::Vector3d(0, 1, -rows[side]).normalized();
  }
  for (size_t corner = 0; corner < 4; ++corner) {
    const Eigen::Vector3d ray = rotation * Eigen::Vector3d(columns[corner % 2], rows[corner / 2], 1);
    piece.edges[2 + corner] = ray.normalized();
    piece.corners[corner] = centre + part.near * ray;
    piece.corners[4 + corner] = centre + part.far * ray;
  }
  for (const auto& corner : piece.corners) {
    piece.largest = std::max(piece.largest, corner.cwiseAbs().maxCoeff());
  }
  return piece;
}

bool intersects(const ConvexPiece& a, const ConvexPiece& b) {
  for (const auto* piece : {&a, &b}) {
    for (const auto& normal : piece->normals) {
      if (separates(normal, a, b)) return false;
    }
  }
  for (const auto& edge_a : a.edges) {
    for (const auto& edge_b : b.edges) {
      const Eigen::Vector3d axis = edge_a.cross(edge_b);
      const double length = axis.norm();
      if (length > kParallel && separates(axis / length, a, b)) return false;
    }
  }
  return true;
}

}  // namespace gld
