#include "infer/forecast/dit_speed.h"

#include "gld/cameras/cameras_in_a_row.h"
#include "gld/machine/timing.h"
#include "models/cost/branch_choice.h"
#include "models/cost/cost_model.h"
#include "models/dit/dit_dh.h"

#include <cmath>

#include <torch/types.h>

namespace gld {
namespace {

constexpr double kFlowTime = 0.5;

// Returns options with one block a part where all of them would take long to make.
DitOptions probe_options(const DitOptions& options, const LatentGrid& grid) {
  constexpr int64_t kMostWeightBytes = 256'000'000;
  DitOptions probe = options;
  probe.conditioning = DitConditioning::kNone;
  if (dit_cost(options, grid).weight_bytes > kMostWeightBytes) probe.depth = {1, 1};
  return probe;
}

LatentGrid probe_grid(const DitOptions& probe, LatentGrid grid) {
  constexpr double kMostFlop = 2e11;
  while (grid.views > 1 && dit_cost(probe, grid).flop() > kMostFlop) --grid.views;
  return grid;
}

}  // namespace

DitSpeed measure_dit_speed(const DitOptions& options, const PlanRequest& request, const MachineSpeed& speed) {
  const torch::NoGradGuard no_gradients;
  const LatentGrid& grid = request.grid;
  const DitOptions probe = probe_options(options, grid);
  const LatentGrid part = probe_grid(probe, grid);
  DitDh model(probe, ParameterPlacement{});
  for (auto& parameter : model.parameters()) {
    const double range = parameter.dim() < 2 ? 0.5 : 1 / std::sqrt(static_cast<double>(parameter.size(1)));
    parameter.uniform_(-range, range);
  }
  LayerPrecision layers = layer_precision(request.flow.precision, ModelKind::kGenerator);
  layers.originals = PackedOriginals::kRelease;  // as when sampling
  use_precision(model, layers);
  const int64_t tokens = model.tokens_per_view(part);
  DitSceneInputs inputs;
  const int64_t side = probe.camera_patch_size;
  inputs.views = cameras_in_a_row({part.views, 1, {part.width * side, part.height * side}});
  inputs.source_features = torch::randn({1, tokens, probe.in_channels});
  set_no_warp(inputs, probe);
  const DitScene scene = model.prepare_scene(inputs);
  const DitTimeRow time = model.time_rows({kFlowTime}).front();
  const auto noisy = torch::randn({part.views, tokens, probe.in_channels});
  DitPasses branches{{&scene, &time, DitBranch::kConditional}};
  const bool batched = request.flow.guidance.guidance_scale != 1 &&
                       choose_branches(request.flow.guidance, options, grid).batched;
  if (batched) branches.push_back({&scene, &time, DitBranch::kUnconditional});
  const DitNoisyTokens embedded = model.embed_noisy(scene, noisy);
  // Nodes are evaluated for one branch at a time.
  const bool nodes = options.conditioning == DitConditioning::kDeeperLevel &&
                     request.flow.approximate.cascade_encoder_nodes > 0;
  const DitPasses encoded = nodes ? DitPasses{branches.front()} : branches;
  DitSpeed result;
  result.condition_encoder = fastest_seconds_of([&] { model.condition_encoder(encoded, embedded); });
  const auto condition = model.condition_encoder(branches, embedded);
  result.velocity_decoder = fastest_seconds_of([&] {
    const auto own = model.embed_noisy(scene, noisy);
    const auto state = batched ? torch::cat({noisy, noisy}) : noisy;
    model.velocity_from_features(model.velocity_features(branches, own, condition), state, kFlowTime);
  });
  const auto scale = [&](double& seconds, size_t runs, Cost whole, const Cost& measured) {
    const LayerPrecision precision = layer_precision(request.flow.precision, ModelKind::kGenerator);
    seconds *= computing_seconds(whole, speed, precision) / computing_seconds(measured, speed, precision) /
               static_cast<double>(runs);
  };
  scale(result.condition_encoder, encoded.size(), condition_encoder_cost(options, grid),
        condition_encoder_cost(probe, part));
  scale(result.velocity_decoder, branches.size(), velocity_decoder_cost(options, grid),
        velocity_decoder_cost(probe, part));
  return result;
}

}  // namespace gld
