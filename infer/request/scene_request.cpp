#include "infer/request/scene_request.h"

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
  PipelineRequest request;
  request.views = scene.views;
  request.source_images = stacked(scene.source_images);
  for (const auto& part : bundle.generators) {
    request.noise.push_back(
        views_noise(static_cast<uint64_t>(noise_seed), level_noise_stream(part.generator.level), grid.views,
                    {part.dit.num_special_tokens + grid.tokens_per_view(), part.dit.in_channels}));
  }
  request.source_depth = scene.seen_depth;
  request.single_source_unit = bundle.unit_of_single_source(scene.views, scene.metric);
  request.single_source_unit_deviation = bundle.single_source_unit_deviation;
  request.source_photographs = scene.photographs;
  request.device = device;
  return request;
}

}  // namespace gld
