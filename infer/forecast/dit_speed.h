#pragma once

#include "infer/forecast/sampling_plan.h"
#include "models/dit/dit_options.h"

namespace gld {

// Seconds of one run of each part of a DiT^DH, for one branch of guidance.
struct DitSpeed {
  double condition_encoder = 0;
  double velocity_decoder = 0;  // with the embedders and the last layer
};

// These seconds are measured: a model of these sizes with random weights runs on cameras in a row, both branches in one
// pass where guidance has them so (models/cost/branch_choice.h). A large model runs with one block a part, and a large
// scene with fewer views, so that it takes at most a few seconds; what they took is then scaled by operations, linear
// layers and attention at the machine's speeds. Unlike operations over peak this sees what small models pay for
// starting operations and for element-wise passes.
DitSpeed measure_dit_speed(const DitOptions& options, const PlanRequest& request, const MachineSpeed& speed);

}  // namespace gld
