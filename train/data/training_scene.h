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
  // Of scenes whose latents were splatted (models/splats/splatted_scene.h), normalised; undefined of others.
  torch::Tensor encoded;   // (views, channels, height', width')
  torch::Tensor degraded;  // the target views', to be repaired, (targets, channels, height', width')
  bool metric = false;     // poses and depth are in metres

  int64_t height() const { return images.size(2); }
  int64_t width() const { return images.size(3); }
  TrainingScene to(torch::Device device) const {
    const auto there = [&](const torch::Tensor& part) { return part.defined() ? part.to(device) : part; };
    return {name, views, images.to(device), there(depth), there(encoded), there(degraded), metric};
  }
};

// One micro-batch: scenes of one resolution. Micro-batches of a step may differ in resolution.
struct TrainingBatch {
  int64_t index = 0;  // position in the run's data
  std::vector<TrainingScene> scenes;
};

}  // namespace gld
