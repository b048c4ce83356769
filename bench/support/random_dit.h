#pragma once

#include "gld/cameras/cameras_in_a_row.h"
#include "gld/machine/matrix_unit.h"
#include "models/dit/dit_dh.h"

#include <cstdint>
#include <memory>

#include <torch/types.h>

namespace gld {

// The model is for measurements: its weights are neither all equal nor growing with depth; what they are does not
// change the time.
std::shared_ptr<DitDh> dit_with_random_weights(const DitOptions& options);

// Returns the same weights, packed for a precision; they can be read no more.
std::shared_ptr<DitDh> packed_copy(const DitDh& model, ComputePrecision precision);
// Returns the same weights on a device.
std::shared_ptr<DitDh> copy_on(const DitDh& model, const torch::Device& device);
// Returns the same weights in float64.
std::shared_ptr<DitDh> double_copy(const DitDh& model);

// A scene and everything that exact savings compute once, of cameras in a row and random latents. Models of equal
// options and any precision have the same cameras and latents, in their own type.
struct RandomDitScene {
  DitScene scene;
  DitTimeRow time;
  torch::Tensor noisy;  // (views, tokens, channels)
};
struct RandomDitSceneSettings {
  CameraRow cameras;
  LatentGrid grid;
  double flow_time = 0.7;
};
RandomDitScene random_scene_for(const DitDh& model, const RandomDitSceneSettings& settings);

}  // namespace gld
