#pragma once

#include "datasets/scenes/frame_checks.h"
#include "train/data/training_scene.h"

#include <cstdint>

#include <torch/types.h>

#include <Eigen/Geometry>

namespace gld::test {

// Returns a scene of three cameras in a row before the wall z = 2, turned a little, whose true rays and targets are
// exact.
inline TrainingScene wall_scene() {
  TrainingScene scene;
  scene.name = "wall";
  scene.views.num_sources = 2;
  scene.images = torch::zeros({3, 3, 56, 56});
  scene.depth = torch::empty({3, 56, 56});
  for (int view = 0; view < 3; ++view) {
    Camera camera;
    camera.width = camera.height = 56;
    camera.intrinsics = intrinsic_matrix(50, 50, 28, 28);
    camera.world_from_camera.translation() = Eigen::Vector3d(0.1 + 0.28 * view, 0, 0);
    camera.world_from_camera.rotate(Eigen::AngleAxisd(0.05 * view, Eigen::Vector3d::UnitY()));
    for (int64_t row = 0; row < 56; ++row) {
      for (int64_t column = 0; column < 56; ++column) {
        const Eigen::Vector3d ray =
            camera.world_from_camera.linear() * camera.intrinsics.inverse() *
            Eigen::Vector3d(static_cast<double>(column) + 0.5, static_cast<double>(row) + 0.5, 1);
        scene.depth[view][row][column] = 2 / ray.z();
      }
    }
    scene.views.cameras.push_back(camera);
  }
  return scene;
}

}  // namespace gld::test
