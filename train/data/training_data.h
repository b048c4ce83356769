#pragma once

#include "datasets/loading/scene_image_loader.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/options.h"
#include "train/data/batch_prefetcher.h"
#include "train/data/kept_folder.h"

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

namespace gld {

// What a run trains on: generated scenes, or folders of scenes in any layout mixed by weight.
struct TrainingDataOptions : OptionsGroup {
  std::vector<std::string> scenes;         // folders; empty: generated scenes
  std::vector<double> weights;             // one a folder; empty: equal
  std::vector<int64_t> longest_intervals;  // one a folder; empty: views.longest_interval for all
  std::vector<double> size_weights;        // one a trained size of the model; empty: equal
  SyntheticOptions synthetic;
  ViewSampling views;
  BatchLoading loading;
  int64_t distinct_batches = 0;      // then the same come again, kept in memory; 0: always new ones
  std::string validation_folder;     // empty: generated scenes of validation_seed
  int64_t validation_seed = 900000;  // must differ from synthetic.seed
  int64_t validation_scenes = 8;
  int64_t validation_sources = 0;  // 0: views.most_sources

  TrainingDataOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// The batches of these datasets: loading.batch_size scenes, sources first. depth: whether scenes carry it.
class DatasetBatches : public TrainingBatchSource {
 public:
  DatasetBatches(const TrainingDataOptions& options, const std::vector<ImageSize>& sizes, FrameParts parts);
  // Takes drawn rooms that come again (distinct_batches) from that folder where it has them, and keeps them there, in
  // memory only what it does not take (a full disk). Scenes of files stay as they are: they may change.
  void keep_in(const std::filesystem::path& folder);
  TrainingBatch batch(int64_t index) const override;
  LoadingReport report() const { return loader_.report(); }

 private:
  std::shared_ptr<const SceneImageBatch> in_memory(int64_t number) const;  // null where it is not

  SceneImageLoader loader_;
  int64_t distinct_ = 0;
  std::string
      drawn_from_;  // everything that a batch of drawn rooms depends on but its number; empty for files
  std::unique_ptr<const KeptFolder> folder_;
  mutable std::mutex mutex_;
  mutable std::map<int64_t, std::shared_ptr<const SceneImageBatch>> kept_;  // by number, below distinct_
};

// Returns the validation scenes: views are spread by views.longest_interval, the first and the last ones are sources
// (with more than two sources, those evenly between them too). They are cut as the training's are.
std::vector<TrainingScene> validation_scenes(const TrainingDataOptions& options, const ImageSize& size,
                                             FrameParts parts);

// Returns views of one scene as tensors, cut about that point: frames[0 .. num_sources) are the sources.
TrainingScene training_scene(const Scene& scene, const SampledViews& views, const ImageSize& size,
                             FrameParts parts, CropCentre centre);

}  // namespace gld
