#include "infer/pipeline/sample_refinement.h"

#include "models/conditioning/level_conditioning.h"
#include "models/refiner/latent_refining.h"
#include "models/refiner/stacked_levels.h"

#include <vector>

namespace gld {

void run_sample_refinement(const PipelineModels& models, const PipelineRequest& request,
                           const std::string& stage, PipelineState& state, PipelineResult& result) {
  const int64_t sources = request.views.num_sources;
  std::vector<torch::Tensor> exact, generated;
  for (size_t i = 0; i < models.levels.generators.size(); ++i) {
    const int64_t level = models.levels.generators[i].level;
    exact.push_back(latent_of_level(state.sources.levels[static_cast<size_t>(level)], state.sources.grid,
                                    models.statistics[i]));
    generated.push_back(state.latents.at(level));
  }
  const auto unet = models.refiner();
  const auto& cameras = request.views.cameras;
  const LatentRefining refining(*unet, {cameras.begin(), cameras.begin() + sources},
                                stacked_levels(exact, state.sources.grid), stage);
  const auto degraded = stacked_levels(generated, result.grid);
  std::vector<torch::Tensor> repaired;
  for (int64_t view = sources; view < request.views.size(); ++view)
    repaired.push_back(refining(cameras[static_cast<size_t>(view)], degraded[view]));
  result.refined = static_cast<int64_t>(repaired.size());
  const auto levels = with_stacked_levels(generated, torch::stack(repaired), sources);
  for (size_t i = 0; i < levels.size(); ++i) {
    const int64_t level = models.levels.generators[i].level;
    state.latents[level] = levels[i];
    result.latents[level] = levels[i].cpu();
  }
}

}  // namespace gld
