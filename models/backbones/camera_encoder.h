#pragma once

#include "gld/cameras/camera.h"
#include "models/layers/layers.h"
#include "models/layers/vit_block.h"

#include <cstdint>
#include <memory>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

struct CameraEncoderSizes {
  int64_t channels = 768;
  int64_t depth = 4;  // blocks over the views
  int64_t num_heads = 16;
};

// Known cameras as the encoder knows them from its training: relative to the first one, centres divided by their unit
// (depth_anything_3/api.py). Depth of what sees views with such tokens is in that unit as well, as far as the network
// believes them.
struct NormalisedCameras {
  std::vector<Camera> cameras;
  // In the world's unit: the median distance from the first centre, which counts with its 0, of an even number the
  // lower of the two in the middle, and at least 0.1. Of two cameras it is therefore always 0.1, as in the published
  // program: two centres 1 apart are told as 10 apart.
  double unit = 1;
};
NormalisedCameras normalised_cameras(const std::vector<Camera>& cameras);

// Makes one token for each known camera (depth_anything_3/model/cam_enc.py): its nine numbers
// (gld/cameras/pose_encoding.h) go through a two-layer network, then through blocks in which the cameras of a scene
// attend to each other.
class CameraEncoder : public torch::nn::Module {
 public:
  CameraEncoder(const CameraEncoderSizes& sizes, const ParameterPlacement& placement);

  // Makes of cameras of the world, not normalised yet, at least one, tokens (views, 1, channels). Their sizes are those
  // that their intrinsics are for, whatever the size of the pictures that the backbone gets.
  torch::Tensor forward(const std::vector<Camera>& cameras) const;

 private:
  CameraEncoderSizes sizes_;
  std::vector<std::shared_ptr<VitBlock>> trunk_;
  std::shared_ptr<LayerNorm> token_norm_, trunk_norm_;
  std::shared_ptr<Linear> hidden_, token_;
};

}  // namespace gld
