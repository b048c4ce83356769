#include "infer/pipeline/scene_request.h"

#include "datasets/loading/batching.h"
#include "gld/latents/noise.h"

namespace gld {

torch::Tensor stacked(const std::vector<Image>& images) {
  std::vector<torch::Tensor> tensors;
  tensors.reserve(images.size());
  for (const auto& image : images) tensors.push_back(to_tensor(image));
  return torch::stack(tensors);
}

PipelineRequest scene_request(const SamplingScene& scene, const BundleOptions& bundle, int64_t noise_seed,
                              const torch::Device& device) {
  const LatentGrid grid = bundle.backbone.grid_of(scene.views.size(), scene.size.height, scene.size.width);
  const auto noise = [&](const char* stream, int64_t channels) {
    return views_noise(static_cast<uint64_t>(noise_seed), stream, grid.views,
                       {grid.tokens_per_view(), channels});
  };
  PipelineRequest request;
  request.views = scene.views;
  request.source_images = stacked(scene.source_images);
  request.level1_noise = noise("level 1", bundle.level1.in_channels);
  request.level0_noise = noise("level 0", bundle.cascade.in_channels);
  request.device = device;
  return request;
}

}  // namespace gld
