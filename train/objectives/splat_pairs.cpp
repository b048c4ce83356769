#include "train/objectives/splat_pairs.h"

#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/mixed_bits.h"
#include "models/refiner/latent_refining.h"

#include <algorithm>
#include <set>
#include <utility>

#include <fmt/format.h>

namespace gld {

void SplatPairOptions::visit(FieldVisitor& visitor) {
  visitor.texts({"pairs", "folders of splatted scenes, pairs/ of gld splat pairs"}, pairs);
  visitor.text({"validation_pairs",
                "the same of scenes to validate on; empty: some of pairs, evenly spread and kept apart"},
               validation_pairs);
  visitor.integer({"validation_scenes", "so many of them at most; 0 validates nothing"}, validation_scenes,
                  {0, 100000});
  visitor.integer({"batch_size", "target views of a micro-batch"}, batch_size, {1, 4096});
  visit_seed(visitor, seed, "the order of scenes and views");
}

void SplatPairOptions::check() const {
  if (pairs.empty()) {
    fail({"--pairs", "a folder of splatted scenes", "nothing",
          "make one with gld splat pairs, and name its folder pairs/"});
  }
}

SplatPairBatches::SplatPairBatches(const SplatPairOptions& options, const RefinerOptions& refiner,
                                   const ModelBundle& bundle)
    : options_(options), refiner_(refiner) {
  options_.check();
  const auto read = [&](const std::string& folder, std::vector<SplattedScene>& scenes) {
    for (const auto& file : splatted_scene_files(folder)) {
      scenes.push_back(read_splatted_scene(file));
      const SplattedScene& scene = scenes.back();
      if (scenes.size() == 1) require_same_normalisation(scene.tag, bundle, file.string());
      const auto& first = scenes.front();
      if (!scene.pictures.sizes().slice(1).equals(first.pictures.sizes().slice(1)) ||
          scene.tag.backbone_hash != first.tag.backbone_hash ||
          scene.tag.statistics_hash != first.tag.statistics_hash) {
        fail({file.string(), "pictures of one size and latents of one model, as in " + first.name, "others",
              "keep them in folders of their own"});
      }
      const auto& backbone = bundle.options().backbone.architecture();
      const int64_t pixels = backbone.patch_side() / backbone.latent_pixels();
      if (scene.encoded.size(2) * pixels != scene.pictures.size(2) ||
          scene.encoded.size(3) * pixels != scene.pictures.size(3)) {
        fail({file.string(), fmt::format("a latent pixel for {0}x{0} pixels of the pictures", pixels),
              fmt::format("{}x{} for {}x{}", scene.encoded.size(3), scene.encoded.size(2),
                          scene.pictures.size(3), scene.pictures.size(2)),
              "make it again with gld splat pairs"});
      }
      if (scene.fitted < refiner_.references) {
        fail({file.string(),
              fmt::format("at least {} fitted views, the refiner's references", refiner_.references),
              std::to_string(scene.fitted), "fit more views, or train a refiner with fewer references"});
      }
    }
  };
  for (const std::string& folder : options_.pairs) read(folder, scenes_);
  if (options_.validation_scenes == 0) return;
  const auto wanted = static_cast<size_t>(options_.validation_scenes);
  if (!options_.validation_pairs.empty()) {
    read(options_.validation_pairs, validation_);
    if (validation_.size() > wanted) validation_.resize(wanted);
  } else {
    const size_t all = scenes_.size();
    for (size_t i = 0; i < all; ++i) {
      if ((i + 1) * wanted / all > i * wanted / all) validation_.push_back(scenes_[i]);
    }
  }
  // A scene may be in several folders, with more views fitted in one than in the other.
  std::set<std::string> names;
  for (const SplattedScene& scene : validation_) names.insert(scene.name);
  const auto validated = [&](const SplattedScene& scene) { return names.count(scene.name) > 0; };
  scenes_.erase(std::remove_if(scenes_.begin(), scenes_.end(), validated), scenes_.end());
  if (scenes_.empty()) {
    fail({"--pairs", "scenes of other names than those that are validated on", "none",
          "lower --validation-scenes, or make more"});
  }
}

TrainingScene SplatPairBatches::scene_of(const SplattedScene& scene, int64_t held_out) const {
  const int64_t target = scene.fitted + held_out;
  const Camera& camera = scene.cameras[static_cast<size_t>(target)];
  TrainingScene result;
  result.name = scene.name;
  std::vector<torch::Tensor> pictures, encoded;
  const auto take = [&](int64_t view) {
    result.views.cameras.push_back(scene.cameras[static_cast<size_t>(view)]);
    pictures.push_back(scene.pictures[view]);
    encoded.push_back(scene.encoded[view]);
  };
  for (const int64_t view : references_of(refiner_, camera, scene.fitted_cameras())) take(view);
  result.views.num_sources = result.views.size();
  take(target);
  result.images = torch::stack(pictures).to(torch::kFloat32) / 255;
  result.encoded = torch::stack(encoded).to(torch::kFloat32);
  result.degraded = scene.degraded(refiner_.degraded).narrow(0, held_out, 1).to(torch::kFloat32);
  return result;
}

TrainingBatch SplatPairBatches::batch(int64_t index) const {
  TrainingBatch batch;
  batch.index = index;
  for (int64_t i = 0; i < options_.batch_size; ++i) {
    const auto pair = static_cast<uint64_t>(index * options_.batch_size + i);
    const uint64_t which = mixed_bits(pair ^ mixed_bits(static_cast<uint64_t>(options_.seed)));
    const SplattedScene& scene = scenes_[which % scenes_.size()];
    const auto held_out = mixed_bits(which) % static_cast<uint64_t>(scene.held_out());
    batch.scenes.push_back(scene_of(scene, static_cast<int64_t>(held_out)));
  }
  return batch;
}

std::vector<TrainingScene> SplatPairBatches::validation() const {
  std::vector<TrainingScene> scenes;
  scenes.reserve(validation_.size());
  for (const SplattedScene& scene : validation_) scenes.push_back(scene_of(scene, 0));
  return scenes;
}

}  // namespace gld
