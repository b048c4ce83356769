#include "datasets/loading/scene_image_loader.h"

#include "gld/base/command_options.h"
#include "gld/base/error.h"

#include <cmath>
#include <sstream>
#include <utility>

namespace gld {
namespace {

// Why a sample was not taken; the kind decides which counter it goes to.
struct Refusal {
  enum class Kind { kShort, kOutlier } kind;
  std::string sentence;
};

// Applies the release's two filters: positions in the world, and relative to the last view.
void check_positions(const Scene& scene, const SampledViews& sampled, double limit) {
  const auto position = [&](int64_t index) -> Eigen::Vector3d {
    return scene.frames[static_cast<size_t>(index)].camera.world_from_camera.translation();
  };
  const auto check = [&](int64_t index, double norm, const std::string& of_what) {
    if (std::isfinite(norm) && norm <= limit) return;
    std::ostringstream text;
    text << scene.name << " " << scene.frames[static_cast<size_t>(index)].name
         << ": expected a camera within " << limit << " of " << of_what
         << " (max_translation_norm), found one at " << norm << ".";
    throw Refusal{Refusal::Kind::kOutlier, text.str()};
  };
  for (int64_t index : sampled.frames) check(index, position(index).norm(), "the origin");
  const Eigen::Vector3d last = position(sampled.frames.back());
  for (int64_t index : sampled.frames) check(index, (position(index) - last).norm(), "the last view");
}

}  // namespace

void BatchLoading::visit(FieldVisitor& visitor) {
  visitor.integer({"batch_size", "scenes in a batch"}, batch_size, {1, 100'000});
  visit_seed(visitor, seed, "the choice of scenes, views and sizes");
  visitor.real(
      {"max_translation_norm",
       "largest distance of a camera from the origin and from the last view, in the scene's unit; samples beyond are "
       "refused"},
      max_translation_norm, {0});
  visitor.integer({"most_attempts", "to replace a sample that cannot be used"}, most_attempts, {1, 10'000});
  visit_choice(visitor, {"crop_centre", "what stays in the middle when pictures are cut to a trained size"},
               crop_centre, {"image", "principal_point"});
  visit_choice(visitor, {"parts", "what is loaded of each frame"}, parts, {"image", "image_and_depth"});
}

SceneImageLoader::SceneImageLoader(Mixture mixture, std::vector<WeightedSize> sizes,
                                   const BatchLoading& options)
    : mixture_(std::move(mixture)), sizes_(std::move(sizes)), options_(options) {
  choose_size(sizes_, 0, 0);  // refuses bad sizes now rather than in a thread
}

LoadingReport SceneImageLoader::report() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return report_;
}

SceneImageBatch SceneImageLoader::load(uint64_t number) const {
  SceneImageBatch batch;
  batch.number = number;
  batch.size = choose_size(sizes_, static_cast<uint64_t>(options_.seed), number);
  for (int64_t slot = 0; slot < options_.batch_size; ++slot) {
    batch.scenes.push_back(load_scene(number, slot, batch.size));
  }
  const std::lock_guard<std::mutex> lock(mutex_);
  ++report_.batches;
  return batch;
}

SceneImages SceneImageLoader::try_scene(const SampleKey& key, const ImageSize& size) const {
  const SampleChoice choice = mixture_.choose(key);
  const MixturePart& part = mixture_.parts()[choice.part];
  const Scene scene = part.dataset->scene(choice.scene);
  const auto sampled = sample_views(part.views, static_cast<int64_t>(scene.frames.size()), key);
  if (!sampled) {
    throw Refusal{Refusal::Kind::kShort, scene.name + ": expected at least " +
                                             std::to_string(part.views.views) + " frames, found " +
                                             std::to_string(scene.frames.size()) + "."};
  }
  check_positions(scene, *sampled, options_.max_translation_norm);
  SceneImages loaded;
  loaded.dataset = part.name;
  loaded.scene = scene.name;
  loaded.num_sources = sampled->num_sources;
  loaded.metric = scene.metric;
  for (int64_t index : sampled->frames) {
    const Frame& frame = scene.frames[static_cast<size_t>(index)];
    loaded.views.push_back(load_sized(frame, size, options_.parts, options_.crop_centre));
    loaded.frame_names.push_back(frame.name);
  }
  return loaded;
}

SceneImages SceneImageLoader::load_scene(uint64_t batch, int64_t slot, const ImageSize& size) const {
  SampleKey key;
  key.seed = static_cast<uint64_t>(options_.seed);
  key.epoch = batch;
  key.index = static_cast<uint64_t>(slot);
  std::string problem;
  for (int64_t attempt = 0; attempt < options_.most_attempts; ++attempt) {
    key.attempt = static_cast<uint64_t>(attempt);
    int64_t LoadingReport::*counter = &LoadingReport::broken_samples;
    try {
      return try_scene(key, size);
    } catch (const Refusal& refusal) {
      counter = refusal.kind == Refusal::Kind::kShort ? &LoadingReport::short_scenes
                                                      : &LoadingReport::pose_outliers;
      problem = refusal.sentence;
    } catch (const Error& error) {
      problem = error.what();
    }
    const std::lock_guard<std::mutex> lock(mutex_);
    ++(report_.*counter);
    report_.last_problem = problem;
  }
  fail({"data loading", "a usable sample within " + std::to_string(options_.most_attempts) + " attempts",
        "none, the last because of: " + problem, "run gld check-data on the dataset"});
}

}  // namespace gld
