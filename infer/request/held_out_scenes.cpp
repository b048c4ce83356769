#include "infer/request/held_out_scenes.h"

#include "gld/base/error.h"
#include "infer/request/scene_request.h"

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

std::unique_ptr<Dataset> held_out_dataset(const std::vector<std::string>& folders,
                                          const SyntheticOptions& generator, int64_t seed, int64_t count) {
  if (!folders.empty()) {
    SceneReading reading;
    reading.broken_frames = BrokenFrames::kSkip;
    return std::make_unique<FolderDataset>(folders, reading);
  }
  SyntheticOptions scenes = generator;
  scenes.seed = seed;
  scenes.scene_count = count;
  return std::make_unique<SyntheticDataset>(scenes);
}

SampleKey held_out_key(int64_t seed, int64_t index) {
  SampleKey key;
  key.seed = static_cast<uint64_t>(seed);
  key.index = static_cast<uint64_t>(index);
  return key;
}

SampledViews held_out_sample(const Scene& scene, const ViewSampling& sampling, const SampleKey& key) {
  const auto chosen = sample_views(sampling, static_cast<int64_t>(scene.frames.size()), key);
  if (!chosen) {
    fail({"scene " + scene.name, fmt::format("at least {} frames", sampling.views),
          std::to_string(scene.frames.size()), "ask for fewer views or leave the scene out"});
  }
  return *chosen;
}

SamplingScene load_selected_views(const Scene& scene, const ViewSelection& selection,
                                  const BundleOptions& bundle) {
  const auto size = choose_size("auto", scene, bundle.image_sizes(), bundle.backbone.patch_side());
  SamplingScene loaded = load_sampling_scene(scene, selection, size);
  load_source_depths(scene, selection, loaded);
  load_source_photographs(scene, selection, kMatchedPhotographSide, loaded);
  return loaded;
}

SamplingScene load_held_out_scene(const Scene& scene, const ViewSampling& sampling, const SampleKey& key,
                                  const BundleOptions& bundle) {
  const SampledViews chosen = held_out_sample(scene, sampling, key);
  const auto first_target = chosen.frames.begin() + static_cast<std::ptrdiff_t>(chosen.num_sources);
  ViewSelection selection;
  selection.sources.assign(chosen.frames.begin(), first_target);
  selection.targets.assign(first_target, chosen.frames.end());
  return load_selected_views(scene, selection, bundle);
}

}  // namespace gld
