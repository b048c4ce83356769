#include "models/dit/flow_matching_loss.h"

#include "gld/flow/flow.h"

#include <cstddef>
#include <vector>

#include <torch/types.h>

namespace gld {
namespace {

torch::Tensor joined(const std::vector<torch::Tensor>& parts) {
  return parts.size() == 1 ? parts.front() : torch::cat(parts);
}

}  // namespace

std::vector<FlowMatchingErrors> flow_matching_errors(const DitDh& model,
                                                     const std::vector<FlowMatchingScene>& scenes) {
  std::vector<DitScene> prepared;
  std::vector<double> times;
  std::vector<torch::Tensor> noisy;
  for (const auto& [inputs, draw] : scenes) {
    prepared.push_back(model.prepare_scene(inputs));
    prepared.back().taps = draw.taps;
    times.push_back(draw.time);
    noisy.push_back(interpolate(draw.clean, draw.noise, draw.time));
  }
  const auto rows = model.time_rows(times);
  DitPasses passes;
  for (size_t i = 0; i < scenes.size(); ++i)
    passes.push_back({&prepared[i], &rows[i], scenes[i].draw.branch});
  const auto velocity = model.velocity(passes, joined(noisy));
  std::vector<FlowMatchingErrors> result;
  int64_t first = 0;
  for (size_t i = 0; i < scenes.size(); ++i) {
    const FlowMatchingDraw& draw = scenes[i].draw;
    const int64_t views = draw.clean.size(0), sources = prepared[i].num_sources();
    const auto squared =
        (velocity.narrow(0, first, views) - velocity_target(draw.clean, draw.noise)).square();
    first += views;
    result.push_back({squared.mean(), squared.detach().narrow(0, 0, sources).mean(),
                      squared.detach().narrow(0, sources, views - sources).mean()});
  }
  return result;
}

FlowMatchingErrors flow_matching_errors(const DitDh& model, const DitSceneInputs& scene,
                                        const FlowMatchingDraw& draw) {
  return flow_matching_errors(model, {{scene, draw}}).front();
}

}  // namespace gld
