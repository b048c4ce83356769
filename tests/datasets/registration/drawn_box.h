#pragma once

#include "datasets/images/image.h"
#include "gld/cameras/camera.h"

#include <cmath>
#include <cstdint>

#include <Eigen/LU>

namespace gld::test {

// The inside of a box, painted with noise that has no two places alike.
struct DrawnBox {
  uint32_t seed = 1;
  Eigen::Vector3d low{-3, -2, -1}, high{3, 2, 6};

  Image seen_by(const Camera& camera) const {
    Image picture(camera.width, camera.height);
    const Eigen::Vector3d origin = camera.world_from_camera.translation();
    const Eigen::Matrix3d world_from_pixel = camera.world_from_camera.linear() * camera.intrinsics.inverse();
    for (int64_t y = 0; y < camera.height; ++y) {
      for (int64_t x = 0; x < camera.width; ++x) {
        const Eigen::Vector3d direction =
            world_from_pixel * Eigen::Vector3d(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5, 1);
        double distance = 1e9;
        for (int axis = 0; axis < 3; ++axis) {
          const double wall = direction[axis] > 0 ? high[axis] : low[axis];
          if (direction[axis] != 0) distance = std::min(distance, (wall - origin[axis]) / direction[axis]);
        }
        const double value = noise(origin + distance * direction);
        for (int c = 0; c < 3; ++c) picture.pixel(x, y)[c] = static_cast<uint8_t>(40 + 170 * value);
      }
    }
    return picture;
  }

 private:
  double noise(const Eigen::Vector3d& at) const {
    return 0.5 * smooth(at * 2.5, 1) + 0.3 * smooth(at * 6, 2) + 0.2 * smooth(at * 14, 3);
  }
  // Returns values of a grid, blended.
  double smooth(const Eigen::Vector3d& at, uint32_t octave) const {
    const Eigen::Vector3d corner = at.array().floor(), inside = at - corner;
    double sum = 0;
    for (int i = 0; i < 8; ++i) {
      const Eigen::Vector3d offset(i & 1, i >> 1 & 1, i >> 2 & 1);
      double weight = 1;
      for (int axis = 0; axis < 3; ++axis) weight *= offset[axis] > 0 ? inside[axis] : 1 - inside[axis];
      sum += weight * value(corner + offset, octave);
    }
    return sum;
  }
  double value(const Eigen::Vector3d& corner, uint32_t octave) const {
    uint32_t bits = seed * 2654435761U + octave * 40503U;
    for (int axis = 0; axis < 3; ++axis) {
      bits ^= static_cast<uint32_t>(static_cast<int32_t>(corner[axis]) + 1000);
      bits *= 0x85EBCA6BU;
      bits ^= bits >> 13;
      bits *= 0xC2B2AE35U;
      bits ^= bits >> 16;
    }
    return static_cast<double>(bits % 1024) / 1023;
  }
};

// The camera looks along z, turned by an angle about y; it has a wide lens, focal_length being over the longer side.
inline Camera camera_in_box(const Eigen::Vector3d& centre, double turn, double focal_length = 0.8,
                            int64_t width = 480, int64_t height = 360) {
  Camera camera;
  camera.width = width;
  camera.height = height;
  const auto w = static_cast<double>(width), h = static_cast<double>(height);
  const double f = focal_length * std::max(w, h);
  camera.intrinsics << f, 0, w / 2, 0, f, h / 2, 0, 0, 1;
  camera.world_from_camera.linear() = Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitY()).matrix();
  camera.world_from_camera.translation() = centre;
  return camera;
}

}  // namespace gld::test
