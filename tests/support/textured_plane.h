#pragma once

#include "gld/cameras/camera.h"
#include "gld/photogrammetry/photo_consistency.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include <Eigen/LU>

namespace gld::test {

// A slanted plane, painted with waves of several lengths, so that windows of it match at one place only.
struct TexturedPlane {
  Eigen::Vector3d normal = Eigen::Vector3d(0.25, -0.2, 1).normalized();
  double distance = 4;  // normal . x = distance

  static float brightness(const Eigen::Vector3d& x, size_t colour) {
    const double shift = 2.1 * static_cast<double>(colour);
    return static_cast<float>(0.5 + 0.16 * std::sin(5.3 * x.x() + 2.9 * x.y() + shift) +
                              0.16 * std::sin(-3.1 * x.x() + 6.7 * x.y() + 2 * shift) +
                              0.16 * std::sin(11.3 * x.x() - 9.1 * x.y() + 3 * shift));
  }

  // Depth is in units that are `unit` long in the world. The view is without a picture where not photographed.
  PicturedView seen_by(const Camera& camera, double unit, bool photographed = true) const {
    PicturedView view;
    view.camera = camera;
    view.width = view.depth.width = camera.width;
    view.height = view.depth.height = camera.height;
    const Eigen::Vector3d centre = camera.world_from_camera.translation();
    for (int64_t y = 0; y < camera.height; ++y) {
      for (int64_t x = 0; x < camera.width; ++x) {
        const Eigen::Vector3d direction =
            camera.world_from_camera.linear() *
            (camera.intrinsics.inverse() *
             Eigen::Vector3d(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5, 1));
        const double depth = (distance - normal.dot(centre)) / normal.dot(direction);
        view.depth.values.push_back(static_cast<float>(depth / unit));
        if (!photographed) continue;
        for (size_t c = 0; c < 3; ++c) view.rgb.push_back(brightness(centre + depth * direction, c));
      }
    }
    return view;
  }
};

// The camera looks along z, turned by an angle about y.
inline Camera camera_before_plane(const Eigen::Vector3d& centre, double turn, int64_t width = 96,
                                  int64_t height = 72) {
  Camera camera;
  camera.width = width;
  camera.height = height;
  const auto w = static_cast<double>(width), h = static_cast<double>(height);
  camera.intrinsics << w, 0, w / 2, 0, w, h / 2, 0, 0, 1;
  camera.world_from_camera.linear() = Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitY()).toRotationMatrix();
  camera.world_from_camera.translation() = centre;
  return camera;
}

// A wall to the left before a sky that does not move with the camera.
inline std::vector<PicturedView> wall_before_sky(const std::vector<Camera>& cameras, double depth_of_sky) {
  const TexturedPlane wall;
  std::vector<PicturedView> views;
  for (const Camera& camera : cameras) {
    PicturedView view = wall.seen_by(camera, 1);
    Camera turned = camera;
    turned.world_from_camera.translation().setZero();
    const PicturedView sky = wall.seen_by(turned, 1);
    for (int64_t y = 0; y < view.height; ++y) {
      for (int64_t x = 0; x < view.width; ++x) {
        const auto i = static_cast<size_t>(y * view.width + x);
        const Eigen::Vector3d direction =
            camera.intrinsics.inverse() *
            Eigen::Vector3d(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5, 1);
        const Eigen::Vector3d place =
            camera.world_from_camera * (direction * static_cast<double>(view.depth.values[i]));
        if (place.x() < 0) continue;
        view.depth.values[i] = static_cast<float>(depth_of_sky);
        std::copy_n(sky.rgb.begin() + static_cast<std::ptrdiff_t>(3 * i), 3,
                    view.rgb.begin() + static_cast<std::ptrdiff_t>(3 * i));
      }
    }
    views.push_back(std::move(view));
  }
  return views;
}

inline std::vector<PicturedView> two_views_of_plane(const TexturedPlane& plane = {}) {
  return {plane.seen_by(camera_before_plane({0, 0, 0}, 0), 1),
          plane.seen_by(camera_before_plane({1.2, 0.2, 0}, -0.25), 1)};
}

// Returns a camera that sees what these two see.
inline Camera camera_between() { return camera_before_plane({0.7, 0.1, 0.3}, -0.15); }

}  // namespace gld::test
