#include "bench/support/random_dit.h"

#include "models/layers/layer_precision.h"

#include <cmath>

#include <ATen/CPUGeneratorImpl.h>
#include <ATen/core/grad_mode.h>

namespace gld {
namespace {

constexpr uint64_t kWeightSeed = 1, kSourceSeed = 2, kNoiseSeed = 3;

std::shared_ptr<DitDh> copied(const DitDh& model, const ParameterPlacement& placement) {
  auto copy = std::make_shared<DitDh>(model.options(), placement);
  const at::NoGradGuard no_grad;
  const auto from = model.named_parameters();
  for (auto& parameter : copy->named_parameters()) parameter.value().copy_(from[parameter.key()]);
  return copy;
}

torch::Tensor random(c10::IntArrayRef sizes, uint64_t seed, const torch::Tensor& like) {
  return torch::randn(sizes, at::detail::createCPUGenerator(seed), torch::TensorOptions(torch::kFloat32))
      .to(like.options());
}

}  // namespace

std::shared_ptr<DitDh> dit_with_random_weights(const DitOptions& options) {
  auto model = std::make_shared<DitDh>(options, ParameterPlacement{});
  const at::NoGradGuard no_grad;
  const auto generator = at::detail::createCPUGenerator(kWeightSeed);
  for (auto& parameter : model->parameters()) {
    if (parameter.dim() < 2) {
      parameter.fill_(0.5);
      continue;
    }
    const double range = 1.0 / std::sqrt(static_cast<double>(parameter[0].numel()));
    parameter.uniform_(-range, range, generator);
  }
  return model;
}

std::shared_ptr<DitDh> packed_copy(const DitDh& model, ComputePrecision precision) {
  auto copy = copy_on(model, model.parameters().front().device());
  LayerPrecision layers = layer_precision(precision, ModelKind::kGenerator);
  layers.originals = PackedOriginals::kRelease;
  use_precision(*copy, layers);
  return copy;
}

std::shared_ptr<DitDh> double_copy(const DitDh& model) {
  ParameterPlacement placement;
  placement.dtype = torch::kFloat64;
  return copied(model, placement);
}

std::shared_ptr<DitDh> copy_on(const DitDh& model, const torch::Device& device) {
  ParameterPlacement placement;
  placement.device = device;
  return copied(model, placement);
}

RandomDitScene random_scene_for(const DitDh& model, const RandomDitSceneSettings& settings) {
  const torch::Tensor like = model.parameters().front();
  const int64_t tokens = model.tokens_per_view(settings.grid), channels = model.options().in_channels;
  DitSceneInputs inputs;
  inputs.views = cameras_in_a_row(settings.cameras);
  inputs.source_features = random({settings.cameras.sources, tokens, channels}, kSourceSeed, like);
  set_no_warp(inputs, model.options());
  RandomDitScene made;
  made.scene = model.prepare_scene(inputs);
  made.time = model.time_rows({settings.flow_time}).front();
  made.noisy = random({settings.cameras.views, tokens, channels}, kNoiseSeed, like);
  return made;
}

}  // namespace gld
