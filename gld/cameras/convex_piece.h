#pragma once

#include "gld/cameras/camera.h"

#include <array>

#include <Eigen/Core>

namespace gld {

// Part of a camera's image between two depths: a pyramid without its top.
struct FrustumPart {
  double left = 0;  // of the image, in image widths from its left border; may lie outside the image
  double right = 1;
  double top = 0;  // in image heights
  double bottom = 1;
  double near = 0;  // planar depth
  double far = 1;
};

// A convex solid with the corners and directions that the separating axis test needs, in the frame of the cameras'
// poses.
struct ConvexPiece {
  std::array<Eigen::Vector3d, 8> corners;
  std::array<Eigen::Vector3d, 5> normals;  // of the faces, of length 1; near and far share one
  std::array<Eigen::Vector3d, 6> edges;    // directions of length 1; near and far share two
  double largest = 0;                      // absolute coordinate, for what counts as rounding
};

ConvexPiece frustum_piece(const Camera& camera, const FrustumPart& part);

// Whether the solids share a point, up to rounding (touching counts): no face normal and no cross product of two edges
// separates them, which is necessary and sufficient for convex polyhedra.
bool intersects(const ConvexPiece& a, const ConvexPiece& b);

}  // namespace gld
