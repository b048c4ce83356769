#pragma once

#include "datasets/loading/mixing.h"
#include "datasets/scenes/resize_crop.h"
#include "gld/base/options.h"

#include <cstdint>
#include <mutex>
#include <string>
#include <vector>

namespace gld {

struct BatchLoading : OptionsGroup {
  int64_t batch_size = 8;  // scenes
  int64_t seed = 0;
  // Of a camera's position, from the scene's origin and from the sample's last view (the frame that the diffusion
  // models see the cameras in), in the scene's unit.
  double max_translation_norm = 100;
  int64_t most_attempts = 20;  // per sample, before loading gives up
  FrameParts parts = FrameParts::kImage;
  CropCentre crop_centre = CropCentre::kImage;

  void visit(FieldVisitor& visitor) override;
};

// A scene on its way from the disk: the pixels of V of its views, sources first, all of the batch's size. As tensors it
// is SceneTensors (datasets/loading/batching.h).
struct SceneImages {
  std::string dataset;
  std::string scene;
  std::vector<std::string> frame_names;
  std::vector<SizedFrame> views;
  int64_t num_sources = 0;
  bool metric = false;
};

struct SceneImageBatch {
  uint64_t number = 0;
  ImageSize size;
  std::vector<SceneImages> scenes;
};

// What loading has met so far.
struct LoadingReport {
  int64_t batches = 0;         // loaded
  int64_t broken_samples = 0;  // scenes or frames that could not be read; others were taken in their place
  int64_t pose_outliers = 0;   // samples refused for max_translation_norm
  int64_t short_scenes = 0;    // scenes with fewer frames than views
  std::string last_problem;    // a sentence, empty when there was none
};

// Chooses and loads batches. Batch n is a pure function of (mixture, sizes, options, n): whoever loads ahead in
// threads gets the same batches whatever their timing, and training resumes by going on with the next number.
class SceneImageLoader {
 public:
  // Throws Error when the sizes or the mixture make no sense.
  SceneImageLoader(Mixture mixture, std::vector<WeightedSize> sizes, const BatchLoading& options);

  // It may be called from several threads. Throws Error when a sample could not be replaced within most_attempts.
  SceneImageBatch load(uint64_t number) const;

  LoadingReport report() const;

 private:
  SceneImages load_scene(uint64_t batch, int64_t slot, const ImageSize& size) const;
  SceneImages try_scene(const SampleKey& key, const ImageSize& size) const;

  Mixture mixture_;
  std::vector<WeightedSize> sizes_;
  BatchLoading options_;
  mutable std::mutex mutex_;
  mutable LoadingReport report_;
};

}  // namespace gld
