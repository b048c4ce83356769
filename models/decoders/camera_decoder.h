#pragma once

#include "gld/cameras/camera.h"
#include "gld/cameras/image_size.h"
#include "models/layers/layers.h"

#include <cstdint>
#include <memory>
#include <vector>

#include <torch/nn/module.h>
#include <torch/types.h>

namespace gld {

// Decodes a camera from each view's camera token, view by view (depth_anything_3/model/cam_dec.py): two linear layers
// with ReLU, and from them a translation, a quaternion, and fields of view that a ReLU keeps from being negative.
class CameraDecoder : public torch::nn::Module {
 public:
  CameraDecoder(int64_t channels, const ParameterPlacement& placement);

  // camera_tokens are (views, channels) of the last level, raw. Returns (views, 9), each a PoseEncoding
  // (gld/cameras/pose_encoding.h) in the frame and unit of the backbone's scene.
  torch::Tensor forward(const torch::Tensor& camera_tokens) const;

  // After random weights this sets no rotation and fields of view of a radian, which a ReLU that starts below 0 would
  // never learn.
  void initialise_output();

 private:
  int64_t channels_;
  std::shared_ptr<Linear> first_, second_, translation_, quaternion_, field_of_view_;
};

// Returns one camera for each row of (views, 9), with the principal point in the middle of images of that size. Throws
// Error where an encoding is that of no camera.
std::vector<Camera> decoded_cameras(const torch::Tensor& encodings, const ImageSize& size);

}  // namespace gld
