#pragma once

#include "infer/export/point_cloud.h"
#include "infer/request/sampling_scene.h"

#include <torch/types.h>

namespace gld {

// What metrics compare with, of a scene as it was loaded.

// Returns (targets, 3, height, width); undefined unless every target view has a picture.
torch::Tensor true_images(const SamplingScene& scene);

// Returns (targets, height, width), 0 where unknown; undefined where no target view has a depth map.
torch::Tensor true_depth(const SamplingScene& scene);

// Returns (views, height, width), 0 where unknown; undefined unless every view has a depth map.
torch::Tensor all_true_depth(const SamplingScene& scene);

// Returns what the true depth of all views shows of the scene, (points, 3); undefined where a view has none.
torch::Tensor true_surface(const SamplingScene& scene);

// Returns (points, 3).
torch::Tensor points_of(const PointCloud& cloud);

}  // namespace gld
