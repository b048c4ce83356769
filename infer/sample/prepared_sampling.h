#pragma once

#include "datasets/scenes/scene.h"
#include "gld/base/work_folder.h"
#include "gld/machine/stage_record.h"
#include "infer/forecast/sampling_plan.h"
#include "infer/method/sample_options.h"
#include "infer/request/sampling_scene.h"
#include "infer/sample/photo_scene.h"
#include "models/bundle/bundle.h"

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// What sampling needs before anything is computed.
struct PreparedSampling {
  torch::Device device;
  ModelBundle bundle;
  std::shared_ptr<const WorkFolder> frames;  // of the videos among the photographs, as files
  std::vector<Photograph> photographs;       // instead of a scene with cameras
  std::optional<PhotoScene> photos;  // once their cameras are estimated; before, stand-ins are in the scene
  Scene found;
  ViewSelection selection;  // as asked for, completed for photographs
  SamplingScene scene;      // without its images
  // Where more or other views are asked for than the model was trained on, a sentence each: doubts of what is
  // generated.
  std::vector<std::string> unlike_training;
  std::optional<ModelBundle> geometry_model;

  explicit PreparedSampling(const SampleOptions& options);  // device and bundle alone

  bool cameras_known() const { return photographs.empty() || photos.has_value(); }
  // A geometry model that is named for the generated images sees the cameras of photographs as well.
  const ModelBundle& camera_model() const { return geometry_model ? *geometry_model : bundle; }
};

// It reads no pixels, and of photographs without cameras no more than their sizes: what is wrong with the options, the
// model or the cameras, or does not fit, is said first, as an Error.
PreparedSampling prepare(const SampleOptions& options);
// Prepares the same of a scene that is at hand, in the place of the one that options.scene names.
PreparedSampling prepare(const SampleOptions& options, Scene scene);

// For photographs it loads and runs the model that sees their cameras, and chooses the views anew.
void estimate_cameras(PreparedSampling& prepared, const SampleOptions& options, StageRecords& stages);

// Loads the pixels of the views, which were chosen without them.
void load_pixels(PreparedSampling& prepared, const SampleOptions& options);

// Returns the parts of the bundle that sampling loads; throws Error where the file of one, or of the geometry model, is
// missing.
std::vector<BundlePart> require_parts(const PreparedSampling& prepared, const SampleOptions& options);

// Returns all but the flow.
PlanRequest plan_request(const PreparedSampling& prepared, const SampleOptions& options);

// Returns why the scene does not fit into memory and what would; empty where it fits. Of a GPU's own memory nothing is
// known here.
std::string memory_problem(const PreparedSampling& prepared, const SampleOptions& options);

}  // namespace gld
