#pragma once

#include "models/dit/dit_dh.h"

#include <vector>

#include <torch/types.h>

namespace gld {

// One draw of the path between data and noise that a model is trained on: x_t = (1 - t) clean + t noise.
struct FlowMatchingDraw {
  torch::Tensor clean;  // (views, special + patch tokens, channels)
  torch::Tensor noise;  // likewise
  double time = 0.5;
  DitBranch branch = DitBranch::kConditional;
  std::vector<AttentionTap>* taps = nullptr;  // DitScene::taps, for losses on attention
};

// Mean squared errors of the velocity noise - clean over all views, and over the source and the target views apart;
// scalars. The last two carry no gradients.
struct FlowMatchingErrors {
  torch::Tensor all;
  torch::Tensor source;
  torch::Tensor target;
};

// A scene and the draw that the model is shown of it.
struct FlowMatchingScene {
  DitSceneInputs inputs;
  FlowMatchingDraw draw;
};

// Computes the flow-matching loss (docs/DESIGN.md section 4, "Flow"; Lipman et al. 2023): what every model of ours is
// trained with, what reference cases replay and what benchmarks time. Scenes are evaluated together, so they have as
// many views of one size each (sources, cameras, times and branches are their own); the errors are those of each.
std::vector<FlowMatchingErrors> flow_matching_errors(const DitDh& model,
                                                     const std::vector<FlowMatchingScene>& scenes);
FlowMatchingErrors flow_matching_errors(const DitDh& model, const DitSceneInputs& scene,
                                        const FlowMatchingDraw& draw);

}  // namespace gld
