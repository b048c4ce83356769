#pragma once

#include "train/data/training_scene.h"

#include <cstdint>
#include <optional>

#include <torch/types.h>

namespace gld {

// The geometry head is trained towards this (Depth Anything 3, section 3): everything is in the first view's camera,
// divided by the mean distance of the visible points from its centre, so that a scene's unit does not matter.
struct GeometryTargets {
  double scale = 1.0;   // scene units per target unit
  torch::Tensor depth;  // (views, height, width), planar
  torch::Tensor valid;  // (views, height, width), bool: depth is known

  // On the ray grid, whose cell (i, j) stands for the point of the image in its middle.
  torch::Tensor rays;       // (views, rows, columns, 6): R K^-1 (u, v, 1), then the camera's centre
  torch::Tensor ray_depth;  // (views, rows, columns), the depth of the pixel under the cell's middle
  torch::Tensor ray_valid;  // (views, rows, columns), bool

  torch::Tensor cameras;  // (views, 9), each a PoseEncoding (gld/cameras/pose_encoding.h)
};

struct RayGrid {
  int64_t rows = 0;
  int64_t columns = 0;
};

// Returns, of each of `cells` that cover so many pixels evenly, the pixel under its middle.
torch::Tensor pixel_under_cell(int64_t cells, int64_t pixels);

// Returns none where no cell's depth is known, which leaves the scale open. Throws Error when the scene comes without
// depth.
std::optional<GeometryTargets> geometry_targets(const TrainingScene& scene, const RayGrid& grid);

}  // namespace gld
