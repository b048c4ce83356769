#include "infer/held_out_scenes.h"

#include "gld/error.h"
#include "infer/scene_request.h"

#include <fmt/format.h>

namespace gld {

ViewSampling held_out_views() {
  ViewSampling views;
  views.views = 4;
  views.shortest_interval = 2;
  views.longest_interval = 7;
  views.fewest_sources = views.most_sources = 2;
  views.sources = SourceChoice::kInterpolate;
  return views;
}

SamplingScene load_held_out_scene(const Scene& scene, const ViewSampling& sampling, const SampleKey& key,
                                  const BundleOptions& bundle) {
  const auto chosen = sample_views(sampling, static_cast<int64_t>(scene.frames.size()), key);
  if (!chosen) {
    fail({"scene " + scene.name, fmt::format("at least {} frames", sampling.views),
          std::to_string(scene.frames.size()), "ask for fewer views or leave the scene out"});
  }
  const auto first_target = chosen->frames.begin() + static_cast<std::ptrdiff_t>(chosen->num_sources);
  ViewSelection selection;
  selection.sources.assign(chosen->frames.begin(), first_target);
  selection.targets.assign(first_target, chosen->frames.end());
  const auto size = choose_size("auto", scene, bundle.image_sizes(), bundle.backbone.patch_size);
  return load_sampling_scene(scene, selection, size);
}

}  // namespace gld
