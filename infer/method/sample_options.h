#pragma once

#include "datasets/formats/scene_reader.h"
#include "datasets/splats/scene_fit.h"
#include "gld/base/options.h"
#include "gld/flow/guidance.h"
#include "gld/flow/solvers/solver.h"
#include "gld/machine/precision_option.h"
#include "infer/export/point_cloud.h"
#include "infer/method/sampling_method.h"
#include "infer/page/page_options.h"
#include "infer/pipeline/photograph_use.h"
#include "infer/request/photo_selection.h"
#include "infer/request/requested_outputs.h"
#include "infer/request/sampling_scene.h"
#include "infer/request/scale_evidence.h"
#include "models/dit/approximate_savings.h"
#include "models/dit/exact_savings.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// How Gaussians are fitted to a run's sources and generated views.
struct SplatOutputOptions : OptionsGroup {
  int64_t side = 512;  // SceneFitOptions
  SplatFitOptions fit;

  SplatOutputOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;
  SceneFitOptions scene_fit(int64_t seed) const;
};

struct SampleOptions : OptionsGroup {
  std::string model = "configs/tiny";
  std::string scene;
  PhotoSelection photos;  // instead of a scene; their cameras are estimated
  SceneReading reading;
  ViewSelection views;
  std::string size = "auto";
  PhotographOptions photograph_use;
  std::vector<std::string> outputs{"image", "depth", "points", "page"};
  // The backbone and geometry head of this bundle look at the generated images; it is empty for the model's own levels.
  std::string geometry_model;
  GeometryCameras geometry_cameras =
      GeometryCameras::kFound;  // what that bundle is told of the views' cameras
  int64_t seed = 0;
  // These stand instead of the options that make up a SamplingMethod: a fixed one, or the cheapest whose measured error
  // stays below a tolerance (infer/method/plan_errors.h; 0 for none). Neither goes together with those options.
  SamplingQuality quality = SamplingQuality::kOptions;
  double tolerance = 0;
  SolverOptions solver;
  GuidanceOptions guidance;
  ApproximateSavings approximate;
  bool refine = false;                                           // SamplingMethod's
  std::vector<std::string> scale_from = usual_scale_evidence();  // of what kinds (scale_evidence.h)
  PointCloudOptions points;
  PageOptions page;
  SplatOutputOptions splats;
  std::vector<std::string> no_skip;  // exact savings to switch off (models/dit/exact_savings.h)
  PrecisionChoice precision = PrecisionChoice::kFloat32;
  std::string device = "cpu";
  int64_t threads = 0;
  // Sampling may take so many gigabytes; 0 stands for what is free.
  double memory_limit = 0;
  bool allow_mixed = false;
  int64_t preview = 0;  // evaluations between two previews; 0: none
  std::string out;
  bool overwrite = false;
  bool resume = false;
  bool json = false;
  // Keys that the command line names, so that a value equal to the default counts as asked for; not an option itself.
  std::vector<std::string> named;

  SampleOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;  // also that nothing contradicts quality or tolerance

  RequestedOutputs requested() const;  // Error for a name that is no output
  ExactSavings savings() const;        // Error for a name that is no saving
  // Returns what all options but tolerance say; precision is float32 for an automatic one.
  SamplingMethod method() const;
};

// Throws Error where the command line names options of an orbit (views.orbit_*) and the targets lie on that other path.
// Options say what their own path is; which one photographs without --path get is known when they are counted.
void refuse_orbit_options_of(const SampleOptions& options, const std::string& path);

}  // namespace gld
