#pragma once

#include "gld/cameras/camera.h"
#include "models/dit/dit_options.h"

#include <map>
#include <string>

#include <torch/types.h>

namespace gld::test {

// DiT^DH once more, written for reading and not for speed: in double, every formula in place, nothing shared with the
// code under test but the cameras (tests/gld/cameras/relative_cameras_test.cpp) and the Plücker image
// (tests/gld/camera_encoding/camera_conditioning_test.cpp).
struct NaiveDitInputs {
  Views views;
  torch::Tensor source_features;  // (views, tokens, channels), zero for target views
  torch::Tensor deeper_level;     // likewise; undefined for level models
  torch::Tensor warp_agreement;   // as DitSceneInputs has them; undefined for models without
  torch::Tensor warped_features;
  torch::Tensor noisy;
  double time = 0;
  bool conditional = true;
};

// The result is (views, tokens, channels). weights are by the names of the checkpoint, in double.
torch::Tensor naive_dit_velocity(const DitOptions& options,
                                 const std::map<std::string, torch::Tensor>& weights,
                                 const NaiveDitInputs& inputs);

}  // namespace gld::test
