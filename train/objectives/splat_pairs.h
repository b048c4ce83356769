#pragma once

#include "gld/base/options.h"
#include "models/refiner/refiner_options.h"
#include "models/splats/splatted_scene.h"
#include "train/data/batch_prefetcher.h"

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace gld {

// Which splatted scenes a refiner is trained on.
struct SplatPairOptions : OptionsGroup {
  std::vector<std::string> pairs;  // folders of gld splat pairs, their pairs/

  // The same of other scenes; empty: validation_scenes of pairs, evenly spread. No scene of such a name is trained on.
  std::string validation_pairs;
  int64_t validation_scenes = 16;
  int64_t batch_size = 8;  // pairs of a micro-batch

  int64_t seed = 0;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Scenes of one target view that nothing was fitted to, and the views nearest to it as its sources.
class SplatPairBatches : public TrainingBatchSource {
 public:
  // Throws Error where a scene has fewer fitted views than the refiner's references, or latents of another model.
  SplatPairBatches(const SplatPairOptions& options, const RefinerOptions& refiner, const ModelBundle& bundle);
  // Returns a scene and one of its held-out views each, drawn by the seed and the batch's number.
  TrainingBatch batch(int64_t index) const override;
  // Returns the first held-out view of every validation scene.
  std::vector<TrainingScene> validation() const;

 private:
  TrainingScene scene_of(const SplattedScene& scene, int64_t held_out) const;

  SplatPairOptions options_;

  RefinerOptions refiner_;
  std::vector<SplattedScene> scenes_, validation_;
};

}  // namespace gld
