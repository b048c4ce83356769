#include "train/objectives/diffusion_replay.h"

#include "models/dit/flow_matching_loss.h"
#include "train/optim/flat_parameters.h"
#include "train/optim/optimiser.h"

#include <torch/autograd.h>

namespace gld {
namespace {

OptimiserOptions optimiser_options(const DiffusionReplayOptions& options) {
  OptimiserOptions result;
  result.betas = options.betas;
  result.epsilon = options.eps;
  result.weight_decay = options.weight_decay;
  result.clip_norm = options.clip_grad_norm;
  result.ema_decay = options.ema_decay;
  return result;
}

// Returns one row of the losses, with the gradients of the first one accumulated.
torch::Tensor losses_of_step(const DitDh& model, const DiffusionReplayScene& scene, double time) {
  FlowMatchingDraw draw;
  draw.clean = scene.clean;
  draw.noise = scene.noise;
  draw.time = time;
  const auto errors = flow_matching_errors(model, scene.inputs, draw);
  errors.all.backward();
  return torch::stack({errors.all.detach(), errors.source, errors.target});
}

}  // namespace

void DiffusionReplayOptions::visit(FieldVisitor& visitor) {
  visitor.real({"learning_rate", "learning rate of AdamW"}, learning_rate, {0, 10});
  visitor.reals({"betas", "decay of the first and the second moment"}, betas, {0, 0.999999});
  visitor.real({"weight_decay", "decoupled weight decay"}, weight_decay, {0, 10});
  visitor.real({"eps", "added to the root of the second moment"}, eps, {0, 1});
  visitor.real({"clip_grad_norm", "largest global gradient norm"}, clip_grad_norm, {0, 1e12});
  visitor.real({"ema_decay", "decay of the moving average"}, ema_decay, {0, 0.9999999});
  visitor.integer({"steps", "optimiser steps"}, steps, {1, 100000});
  visitor.real({"time", "flow time of every step"}, time, {0, 1});
}

void DiffusionReplayOptions::check() const { optimiser_options(*this).check(); }

std::map<std::string, torch::Tensor> replay_diffusion_training(DitDh& model,
                                                               const DiffusionReplayScene& scene,
                                                               const DiffusionReplayOptions& options) {
  const torch::AutoGradMode gradients(true);
  FlatParameters parameters(named_parameters(model));
  Optimiser optimiser(parameters, optimiser_options(options));
  std::map<std::string, torch::Tensor> results;
  std::vector<torch::Tensor> losses;
  for (int64_t step = 0; step < options.steps; ++step) {
    parameters.zero_gradients();
    losses.push_back(losses_of_step(model, scene, options.time));
    const double norm = optimiser.gradient_norm();
    results["grad_norm.step" + std::to_string(step)] = torch::full({1}, norm, torch::kFloat64);
    for (size_t i = 0; step == 0 && i < parameters.parameters().size(); ++i) {
      results["grad." + parameters.parameters()[i].name] = parameters.part(parameters.gradients(), i).clone();
    }
    optimiser.step(options.learning_rate, norm);
  }
  for (size_t i = 0; i < parameters.parameters().size(); ++i) {
    const auto& name = parameters.parameters()[i].name;
    results["param." + name] = parameters.part(parameters.values(), i).clone();
    if (optimiser.has_average()) results["ema." + name] = parameters.part(optimiser.average(), i).clone();
  }
  results["losses"] = torch::stack(losses);
  return results;
}

}  // namespace gld
