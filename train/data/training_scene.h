#pragma once

#include "gld/cameras/camera.h"

#include <cstdint>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// The views of one scene as a training step takes them: source views first, images in whole patches.
struct TrainingScene {
  std::string name;
  Views views;
  torch::Tensor images;  // (views, 3, height, width), RGB in [0, 1], float32
  torch::Tensor depth;  // (views, height, width), planar, unit of the poses, 0 = not known; undefined without

  int64_t height() const { return images.size(2); }
  int64_t width() const { return images.size(3); }
  TrainingScene to(torch::Device device) const {
    return {name, views, images.to(device), depth.defined() ? depth.to(device) : depth};
  }
};

// One micro-batch: scenes of one resolution. Micro-batches of a step may differ in resolution.
struct TrainingBatch {
  int64_t index = 0;  // position in the run's data
  std::vector<TrainingScene> scenes;
};

}  // namespace gld
