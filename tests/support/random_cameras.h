#pragma once

#include "gld/cameras/camera.h"

#include <cmath>
#include <random>

#include <Eigen/Geometry>

namespace gld::test {

// Random cameras for tests; the numbers differ between standard libraries, the properties tested do not.
class RandomCameras {
 public:
  explicit RandomCameras(uint32_t seed) : engine_(seed) {}

  double uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(engine_);
  }
  // Returns 10^uniform.
  double power(double low, double high) { return std::pow(10.0, uniform(low, high)); }
  int64_t integer(int64_t low, int64_t high) {
    return std::uniform_int_distribution<int64_t>(low, high)(engine_);
  }
  Eigen::Vector3d vector(double size) {
    return {uniform(-size, size), uniform(-size, size), uniform(-size, size)};
  }
  Eigen::Matrix3d rotation(double largest_angle) {
    return Eigen::AngleAxisd(uniform(0, largest_angle), vector(1).normalized()).toRotationMatrix();
  }

  // Returns a camera near the origin that looks roughly forward.
  Camera ordinary(int64_t width, int64_t height) {
    Camera camera;
    camera.width = width;
    camera.height = height;
    camera.intrinsics << uniform(0.7, 1.3) * static_cast<double>(width), 0,
        0.5 * static_cast<double>(width) + 1, 0, uniform(0.7, 1.3) * static_cast<double>(height),
        0.5 * static_cast<double>(height) - 1, 0, 0, 1;
    camera.world_from_camera.linear() = rotation(0.6);
    camera.world_from_camera.translation() = vector(1);
    return camera;
  }

  struct SceneSizes {
    int64_t views = 4;
    int64_t sources = 2;
    int64_t width = 84;
    int64_t height = 56;
  };
  Views ordinary_scene(const SceneSizes& sizes) {
    Views views;
    views.num_sources = sizes.sources;
    for (int64_t i = 0; i < sizes.views; ++i) views.cameras.push_back(ordinary(sizes.width, sizes.height));
    return views;
  }

  // The scene has fx/W from 0.05 to 50, a scale from 1e-8 to 1e8, a world offset of up to 1e6, centres that coincide in
  // one scene of four, principal points outside the image, fx unlike fy.
  Views extreme_scene() {
    Views views;
    const int64_t count = integer(2, 8);
    views.num_sources = integer(1, count - 1);
    const double scale = power(-8, 8);
    const Eigen::Vector3d offset = uniform(0, 1) < 0.3 ? Eigen::Vector3d::Zero() : vector(power(-3, 6));
    const bool coincident = uniform(0, 1) < 0.25;
    const auto width = integer(1, 6), height = integer(1, 6);
    for (int64_t i = 0; i < count; ++i) {
      Camera camera;
      camera.width = width;
      camera.height = height;
      const auto w = static_cast<double>(width), h = static_cast<double>(height);
      camera.intrinsics << w * power(std::log10(0.05), std::log10(50.0)), 0, w * uniform(-3, 4), 0,
          h * power(std::log10(0.05), std::log10(50.0)), h * uniform(-3, 4), 0, 0, 1;
      camera.world_from_camera.linear() = rotation(3.14);
      camera.world_from_camera.translation() = coincident ? offset : Eigen::Vector3d(offset + vector(scale));
      views.cameras.push_back(camera);
    }
    return views;
  }

 private:
  std::mt19937 engine_;
};

}  // namespace gld::test
