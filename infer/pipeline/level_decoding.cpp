#include "infer/pipeline/level_decoding.h"

#include "gld/base/error.h"
#include "models/conditioning/decoder_inputs.h"

#include <map>
#include <utility>

#include <fmt/format.h>

namespace gld {

void require_finite(const torch::Tensor& tensor, const std::string& stage, const std::string& what) {
  if (tensor.isfinite().all().item<bool>()) return;
  fail({stage, "finite numbers", "NaN or infinity in the " + what,
        "check the input images and cameras, and verify the weights with gld verify"});
}

CompletedLevels complete_levels(const PipelineModels& models, const PipelineState& state,
                                const LatentGrid& grid, const std::string& stage) {
  const LatentSpace space(models.backbone(), models.levels.boundary);
  std::map<int64_t, torch::Tensor> raw;
  for (size_t i = 0; i < models.levels.generators.size(); ++i) {
    const int64_t level = models.levels.generators[i].level;
    raw[level] = models.statistics[i].denormalise(state.latents.at(level));
  }
  auto levels = space.complete(raw, state.sources.leading, grid);
  for (size_t level = 0; level < levels.patches.size(); ++level) {
    if (levels.patches[level].defined())
      require_finite(levels.patches[level], stage, fmt::format("level {} features", level));
  }
  return levels;
}

DecodableViews select_views(const std::vector<torch::Tensor>& levels, const LatentGrid& grid,
                            DecodedViews which, int64_t num_sources) {
  const int64_t first = which == DecodedViews::kTargets ? num_sources : 0;
  DecodableViews selected;
  selected.grid = grid;
  selected.grid.views = grid.views - first;
  for (const torch::Tensor& level : levels) {
    selected.levels.push_back(level.defined() ? level.slice(0, first).contiguous() : level);
  }
  return selected;
}

torch::Tensor decoded_images(const PipelineModels& models, const DecodableViews& views,
                             const std::string& stage) {
  const auto features = image_features(views.levels, models.levels.decoded_levels());
  auto images = models.rgb_decoder()->decode(features, views.grid).cpu();
  require_finite(images, stage, "images");
  return images;
}

}  // namespace gld
