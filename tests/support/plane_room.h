#pragma once

#include "gld/cameras/camera.h"

#include <cmath>
#include <cstdint>
#include <vector>

#include <torch/types.h>

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace gld::test {

// Cameras on an arc that look at a slanted wall, n x = d, which fills every view: depth is exact, and so is where each
// pixel is seen in other views.
struct PlaneRoom {
  Eigen::Vector3d normal = Eigen::Vector3d(0.2, -0.1, 1).normalized();
  double distance = 4;
  std::vector<Camera> cameras;

  PlaneRoom(int64_t views, int64_t width, int64_t height) {
    for (int64_t i = 0; i < views; ++i) {
      Camera camera;
      camera.width = width;
      camera.height = height;
      camera.intrinsics << static_cast<double>(width), 0, 0.5 * static_cast<double>(width), 0,
          static_cast<double>(width), 0.5 * static_cast<double>(height), 0, 0, 1;
      const double angle = 0.08 * static_cast<double>(i);
      camera.world_from_camera.linear() =
          Eigen::AngleAxisd(angle, Eigen::Vector3d(0.1, 1, 0).normalized()).toRotationMatrix();
      camera.world_from_camera.translation() = Eigen::Vector3d(
          -0.3 * static_cast<double>(i), 0.05 * static_cast<double>(i * i), 0.1 * std::sin(3 * angle));
      cameras.push_back(camera);
    }
  }

  Eigen::Vector3d ray(const Camera& camera, double u, double v) const {
    return camera.world_from_camera.linear() * (camera.intrinsics.inverse() * Eigen::Vector3d(u, v, 1));
  }
  // Returns where the middle of that pixel meets the wall.
  Eigen::Vector3d point(const Camera& camera, double u, double v) const {
    return camera.world_from_camera.translation() + depth(camera, u, v) * ray(camera, u, v);
  }
  double depth(const Camera& camera, double u, double v) const {
    return (distance - normal.dot(camera.world_from_camera.translation())) / normal.dot(ray(camera, u, v));
  }
  // The maps are (views, height, width), float64.
  torch::Tensor depth_maps() const {
    std::vector<torch::Tensor> maps;
    for (const Camera& camera : cameras) {
      auto map = torch::empty({camera.height, camera.width}, torch::kFloat64);
      for (int64_t y = 0; y < camera.height; ++y) {
        for (int64_t x = 0; x < camera.width; ++x) {
          map.data_ptr<double>()[y * camera.width + x] =
              depth(camera, static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5);
        }
      }
      maps.push_back(map);
    }
    return torch::stack(maps);
  }
  // Returns a smooth texture of the wall, one vector of `channels` a pixel: (views, channels, height, width) in [0, 1].
  torch::Tensor textures(int64_t channels) const {
    std::vector<torch::Tensor> maps;
    for (const Camera& camera : cameras) {
      auto map = torch::empty({channels, camera.height, camera.width}, torch::kFloat64);
      auto* value = map.data_ptr<double>();
      for (int64_t channel = 0; channel < channels; ++channel) {
        const Eigen::Vector3d wave(1 + static_cast<double>(channel), 2 - static_cast<double>(channel), 0.5);
        for (int64_t y = 0; y < camera.height; ++y) {
          for (int64_t x = 0; x < camera.width; ++x) {
            const Eigen::Vector3d p =
                point(camera, static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5);
            *value++ = 0.5 + 0.5 * std::sin(wave.dot(p) + static_cast<double>(channel));
          }
        }
      }
      maps.push_back(map);
    }
    return torch::stack(maps);
  }
};

}  // namespace gld::test
