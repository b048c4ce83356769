#pragma once

#include "datasets/loading/scene_image_loader.h"
#include "gld/cameras/camera.h"

#include <vector>

#include <torch/types.h>

namespace gld {

// One scene of a batch as tensors on the CPU.
struct SceneTensors {
  torch::Tensor images;    // (views, 3, height, width), float32 in [0, 1]
  torch::Tensor depth;     // (views, height, width), float32, 0 where unknown; undefined when not loaded
  torch::Tensor validity;  // (views, height, width), float32, 1 valid and 0 not
  Views views;             // the cameras, sources first
};

// These give an image as (3, height, width) in [0, 1], and back (rounded, clamped, black where a value is no number).
torch::Tensor to_tensor(const Image& image);
Image to_image(const torch::Tensor& image);

// The tensor is (height, width), float32.
torch::Tensor to_tensor(const DepthMap& depth);
DepthMap to_depth_map(const torch::Tensor& depth);

SceneTensors to_tensors(const SceneImages& scene);

}  // namespace gld
