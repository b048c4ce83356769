#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace gld {

// A pinhole camera in OpenCV convention (x right, y down, z forward). Pixel (0, 0) has its centre at (0.5, 0.5).
struct Camera {
  int64_t width = 0;                                         // pixels
  int64_t height = 0;                                        // pixels
  Eigen::Matrix3d intrinsics = Eigen::Matrix3d::Identity();  // pixels, zero skew
  Eigen::Isometry3d world_from_camera = Eigen::Isometry3d::Identity();

  Eigen::Isometry3d camera_from_world() const { return world_from_camera.inverse(); }
};

// The views of one scene, source views first (DESIGN.md section 1).
struct Views {
  std::vector<Camera> cameras;
  int64_t num_sources = 0;

  int64_t size() const { return static_cast<int64_t>(cameras.size()); }
  int64_t num_targets() const { return size() - num_sources; }
};

// The token grid of a set of views.
struct LatentGrid {
  int64_t views = 0;
  int64_t height = 0;  // tokens
  int64_t width = 0;   // tokens

  int64_t tokens_per_view() const { return height * width; }
};

}  // namespace gld
