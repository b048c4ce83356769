#pragma once

#include "infer/evaluate/evaluation_models.h"
#include "infer/request/sampling_scene.h"
#include "models/scene_geometry/composed_views.h"

#include <string>

#include <torch/types.h>

namespace gld {

// What the source views say of the target views without anything generated.

// Returns for every target the image of the source whose camera centre is nearest, (targets, 3, height, width).
torch::Tensor nearest_sources(const Views& views, const torch::Tensor& source_images);

// The photographs carried by the depth of their own views, as the model and `photographs` of the evaluation find it.
struct CarriedPictures {
  torch::Tensor images;   // gaps from the nearest pixel; undefined where nothing could be carried
  torch::Tensor depth;    // of the nearest source, in the scene's unit; undefined where that is not known
  std::string no_images;  // why there are none; empty where there are
  std::string no_depth;
  FilledViews filled;  // undefined where nothing could be carried
};
CarriedPictures carried_pictures(const EvaluationModels& models, const SamplingScene& scene);

// Returns what the true depth of the sources would carry; it is undefined unless every source has a depth map.
FilledViews filled_by_true_depth(const SamplingScene& scene);

}  // namespace gld
