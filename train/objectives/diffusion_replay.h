#pragma once

#include "gld/base/options.h"
#include "models/dit/dit_dh.h"

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// A few steps of training on one scene at a fixed flow time with fixed noise: what a reference case records.
struct DiffusionReplayOptions : OptionsGroup {
  double learning_rate = 5e-5;
  std::vector<double> betas = {0.9, 0.95};
  double weight_decay = 0;
  double eps = 1e-8;
  double clip_grad_norm = 1.0;
  double ema_decay = 0.9995;
  int64_t steps = 1;
  double time = 0.5;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

struct DiffusionReplayScene {
  DitSceneInputs inputs;
  torch::Tensor clean;  // (views, tokens, channels)
  torch::Tensor noise;  // likewise
};

// Trains model in place with the loop's own optimiser (train/optim/optimiser.h). Returns "losses" (steps, 3: all views,
// source views, target views), "grad_norm.step0", ..., the first step's gradients "grad.NAME" before clipping, and the
// final "param.NAME" and "ema.NAME".
std::map<std::string, torch::Tensor> replay_diffusion_training(DitDh& model,
                                                               const DiffusionReplayScene& scene,
                                                               const DiffusionReplayOptions& options);

}  // namespace gld
