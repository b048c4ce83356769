#include "train/data/training_data.h"

#include "datasets/loading/batching.h"
#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/option_differences.h"
#include "train/data/kept_batch.h"

#include <algorithm>

namespace gld {
namespace {

Mixture mixture_of(const TrainingDataOptions& options) {
  std::vector<MixturePart> parts;
  if (options.scenes.empty()) {
    MixturePart part;
    part.name = "synthetic";
    part.dataset = std::make_shared<SyntheticDataset>(options.synthetic);
    part.views = options.views;
    parts.push_back(std::move(part));
  }
  for (size_t i = 0; i < options.scenes.size(); ++i) {
    MixturePart part;
    part.name = options.scenes[i];
    SceneReading reading;
    reading.broken_frames = BrokenFrames::kSkip;
    part.dataset = std::make_shared<FolderDataset>(options.scenes[i], reading);
    part.weight = options.weights.empty() ? 1.0 : options.weights[i];
    part.views = options.views;
    if (!options.longest_intervals.empty()) part.views.longest_interval = options.longest_intervals[i];
    parts.push_back(std::move(part));
  }
  return Mixture(std::move(parts));
}

std::vector<WeightedSize> weighted(const std::vector<ImageSize>& sizes, const std::vector<double>& weights) {
  if (!weights.empty() && weights.size() != sizes.size()) {
    fail({"data.size_weights", std::to_string(sizes.size()) + " weights, one a trained size of the model",
          std::to_string(weights.size()), "give as many or none"});
  }
  std::vector<WeightedSize> result;
  for (size_t i = 0; i < sizes.size(); ++i) result.push_back({sizes[i], weights.empty() ? 1.0 : weights[i]});
  return result;
}

BatchLoading with_parts(BatchLoading loading, FrameParts parts) {
  loading.parts = parts;
  return loading;
}

TrainingScene to_training_scene(const SceneImages& loaded) {
  const SceneTensors tensors = to_tensors(loaded);
  TrainingScene scene;
  scene.name = loaded.scene;
  scene.views = tensors.views;
  scene.images = tensors.images;
  scene.depth = tensors.depth;
  scene.metric = loaded.metric;
  if (scene.depth.defined() && tensors.validity.defined()) scene.depth = scene.depth * tensors.validity;
  return scene;
}

TrainingBatch to_training_batch(const SceneImageBatch& loaded, int64_t index) {
  TrainingBatch batch;
  batch.index = index;
  for (const SceneImages& scene : loaded.scenes) batch.scenes.push_back(to_training_scene(scene));
  return batch;
}

}  // namespace

TrainingDataOptions::TrainingDataOptions() {
  synthetic.seed = 1;
  synthetic.scene_count = 1'000'000;
}

void TrainingDataOptions::visit(FieldVisitor& visitor) {
  visit_scenes(visitor, scenes, "generated ones");
  visitor.reals({"weights", "share of the samples from each folder; none is equal shares"}, weights,
                {1e-9, 1e9});
  visitor.integers(
      {"longest_intervals", "longest interval between views for each folder; none is that of views"},
      longest_intervals, {1, 1'000'000});
  visitor.reals(
      {"size_weights", "share of the batches at each trained size of the model; none is equal shares"},
      size_weights, {1e-9, 1e9});
  visitor.group({"synthetic", "generated scenes"}, synthetic);
  visitor.group({"views", "which frames make a training scene"}, views);
  visitor.group({"loading", "micro-batches and what is refused"}, loading);
  visitor.integer({"distinct_batches",
                   "micro-batches that are drawn before the same ones come again, kept in memory or "
                   "in --kept-scenes; 0 always draws new ones"},
                  distinct_batches, {0, 1'000'000'000});
  visitor.text({"validation_folder", "folder of held-out scenes; none is generated scenes"},
               validation_folder);
  visitor.integer({"validation_seed", "seed of the generated validation scenes"}, validation_seed,
                  {0, 1'000'000'000'000});
  visitor.integer({"validation_scenes", "number of validation scenes; 0 validates nothing"},
                  validation_scenes, {0, 100000});
  visitor.integer({"validation_sources", "source views of a validation scene; 0 is views.most_sources"},
                  validation_sources, {0, 999});
}

void TrainingDataOptions::check() const {
  if (!weights.empty() && weights.size() != scenes.size()) {
    fail({"data.weights", std::to_string(scenes.size()) + " weights, one a folder",
          std::to_string(weights.size()), "give as many or none"});
  }
  if (!longest_intervals.empty() && longest_intervals.size() != scenes.size()) {
    fail({"data.longest_intervals", std::to_string(scenes.size()) + " intervals, one a folder",
          std::to_string(longest_intervals.size()), "give as many or none"});
  }
  if (scenes.empty() && validation_folder.empty() && synthetic.seed == validation_seed) {
    fail({"data.validation_seed", "another seed than synthetic.seed", std::to_string(validation_seed),
          "choose one that training never sees"});
  }
}

DatasetBatches::DatasetBatches(const TrainingDataOptions& options, const std::vector<ImageSize>& sizes,
                               FrameParts parts)
    : loader_(mixture_of(options), weighted(sizes, options.size_weights), with_parts(options.loading, parts)),
      distinct_(options.distinct_batches) {
  options.check();
  if (!options.scenes.empty()) return;
  drawn_from_ = to_yaml_without(options, {"distinct_batches", "validation_folder", "validation_seed",
                                          "validation_scenes", "validation_sources"});
  for (const ImageSize& size : sizes) drawn_from_ += size_text(size.width, size.height) + '\n';
  drawn_from_ += parts == FrameParts::kImageAndDepth ? "with depth" : "pictures";
}

void DatasetBatches::keep_in(const std::filesystem::path& folder) {
  if (distinct_ > 0 && !drawn_from_.empty())
    folder_ = std::make_unique<const KeptFolder>(folder, "drawn rooms\n" + drawn_from_);
}

std::shared_ptr<const SceneImageBatch> DatasetBatches::in_memory(int64_t number) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto found = kept_.find(number);
  return found == kept_.end() ? nullptr : found->second;
}

TrainingBatch DatasetBatches::batch(int64_t index) const {
  if (distinct_ == 0) return to_training_batch(loader_.load(static_cast<uint64_t>(index)), index);
  const int64_t number = index % distinct_;
  if (const auto kept = in_memory(number)) return to_training_batch(*kept, index);
  const std::string key = std::to_string(number);
  if (folder_) {
    if (const auto kept = folder_->find(key)) {
      if (auto batch = batch_of(*kept, index)) return std::move(*batch);
    }
  }
  auto loaded = std::make_shared<const SceneImageBatch>(loader_.load(static_cast<uint64_t>(number)));
  TrainingBatch made = to_training_batch(*loaded, index);
  if (folder_ && folder_->keep(key, kept_batch(made))) return made;
  const std::lock_guard<std::mutex> lock(mutex_);
  kept_[number] = std::move(loaded);
  return made;
}

TrainingScene training_scene(const Scene& scene, const SampledViews& views, const ImageSize& size,
                             FrameParts parts, CropCentre centre) {
  SceneImages loaded;
  loaded.scene = scene.name;
  loaded.num_sources = views.num_sources;
  loaded.metric = scene.metric;
  for (const int64_t frame : views.frames) {
    const Frame& source = scene.frames[static_cast<size_t>(frame)];
    loaded.frame_names.push_back(source.name);
    loaded.views.push_back(load_sized(source, size, parts, centre));
  }
  return to_training_scene(loaded);
}

std::vector<TrainingScene> validation_scenes(const TrainingDataOptions& options, const ImageSize& size,
                                             FrameParts parts) {
  if (options.validation_scenes == 0) return {};
  std::shared_ptr<const Dataset> dataset;
  if (options.validation_folder.empty()) {
    SyntheticOptions synthetic = options.synthetic;
    synthetic.seed = options.validation_seed;
    synthetic.scene_count = options.validation_scenes;
    dataset = std::make_shared<SyntheticDataset>(synthetic);
  } else {
    SceneReading reading;
    reading.broken_frames = BrokenFrames::kSkip;
    dataset = std::make_shared<FolderDataset>(options.validation_folder, reading);
  }
  ViewSampling sampling = options.views;
  sampling.sources = SourceChoice::kInterpolate;
  if (options.validation_sources > 0) sampling.most_sources = options.validation_sources;
  sampling.most_sources = std::min(sampling.most_sources, sampling.views - 1);
  sampling.fewest_sources = std::min(sampling.fewest_sources, sampling.most_sources);
  std::vector<TrainingScene> scenes;
  const int64_t count = std::min(options.validation_scenes, dataset->size());
  for (int64_t index = 0; index < count; ++index) {
    const Scene scene = dataset->scene(index);
    SampleKey key;
    key.seed = static_cast<uint64_t>(options.validation_seed);
    key.index = static_cast<uint64_t>(index);
    const auto views = sample_views(sampling, static_cast<int64_t>(scene.frames.size()), key);
    if (!views) {
      fail(
          {"scene " + scene.name, "at least " + std::to_string(sampling.views) + " frames",
           std::to_string(scene.frames.size()),
           options.validation_folder.empty()
               ? "that room is drawn for validation: raise --data.synthetic.frames, or validate on scenes of your "
                 "own with --validation-folder"
               : "validate on longer scenes"});
    }
    scenes.push_back(training_scene(scene, *views, size, parts, options.loading.crop_centre));
  }
  return scenes;
}

}  // namespace gld
