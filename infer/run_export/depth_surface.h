#pragma once

#include "datasets/images/image.h"
#include "gld/cameras/camera.h"

#include <cstdint>
#include <limits>
#include <vector>

#include <Eigen/Core>

namespace gld {

struct DepthSurfaceOptions {
  int64_t step = 1;  // pixels from one vertex to the next
  // A surface is cut where inverse depth changes from a vertex to the next by more than this, relative to itself,
  // beyond how it changes a few pixels to both sides. On a plane seen in perspective the difference is 0.
  double edge_step = 0.02;
  double farthest = std::numeric_limits<double>::infinity();  // deeper pixels are left out
};

// What a view's depth shows as triangles, each vertex the middle of a pixel.
struct DepthSurface {
  std::vector<Eigen::Vector3f> x_in_camera;  // OpenCV: x right, y down, z forward
  // Of the picture's width and height, from its upper left corner.
  std::vector<Eigen::Vector2f> texture;
  // Three vertices a triangle, counter-clockwise as the camera sees them.
  std::vector<uint32_t> corners;

  bool empty() const { return corners.empty(); }
};

// The camera is of the depth map's size. Neighbouring pixels are joined where both are known, near enough, and on one
// surface: their depths differ by less than 8 %, and not by edge_step more than those around. Vertices that no
// triangle has are left out.
DepthSurface depth_surface(const DepthMap& depth, const Camera& camera, const DepthSurfaceOptions& options);

}  // namespace gld
