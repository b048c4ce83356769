#pragma once

#include "datasets/images/image.h"
#include "infer/evaluate/scene_evaluation.h"
#include "infer/request/sampling_scene.h"

namespace gld {

// Draws the sources, then of each target view the truth, the prediction of the mean and the sample, and at last what
// the true features of the first target say, all together and each level alone (figure 3 of the paper).
Image scene_sheet(const SamplingScene& scene, const EvaluatedScene& evaluated);

}  // namespace gld
