#pragma once

#include "datasets/scenes/view_sampling.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/options.h"
#include "gld/distributed/process_placement.h"
#include "gld/flow/guidance.h"
#include "gld/flow/solvers/solver.h"
#include "infer/evaluate/evaluated_views.h"
#include "infer/evaluate/pose_estimation.h"
#include "infer/method/sample_options.h"
#include "infer/request/held_out_scenes.h"
#include "models/losses/lpips_files.h"

#include <cstdint>
#include <string>

namespace gld {

// gld eval makes and measures novel views of scenes with known truth. Samples and the prediction of the mean are
// measured side by side; the prediction of the mean is fixed; solver and guidance are those of the samples.
struct EvaluationOptions : OptionsGroup {
  std::string model = "configs/tiny";
  std::string out;
  bool overwrite = false;
  bool resume = false;
  bool allow_mixed = false;
  bool json = false;
  int64_t synthetic = 64;                 // generated scenes; 0 when scenes are given
  int64_t synthetic_seed = kHeldOutSeed;  // training and validation use others
  std::vector<std::string> scenes;        // folders; empty: generated ones
  SyntheticOptions generator;             // what the generated scenes look like
  ViewSampling views;
  std::vector<int64_t> source_counts;
  std::vector<int64_t> source_frames;
  std::vector<int64_t> target_frames;
  PhotographOptions photograph_use;
  int64_t samples = 1;  // a scene and number of sources
  SolverOptions solver = SampleOptions().solver;
  GuidanceOptions guidance = SampleOptions().guidance;
  bool refine = false;  // SamplingMethod's, of the samples
  int64_t seed = 0;     // of the first scene's noise; each next scene has the next seed
  PoseEstimator poses = PoseEstimator::kOurs;
  std::string pose_model;  // whose geometry head looks at the pictures; empty: the model's own
  // Queries and keys of the DiTs are matched at these flow times (attention_correspondence.h); where this is empty,
  // they are not matched at all.
  std::vector<double> attention_times;
  LpipsFiles lpips;
  int64_t pictures = 6;
  ComputePrecision precision = ComputePrecision::kFloat32;
  std::string device = "cpu";
  int64_t threads = 0;
  ProcessesOptions processes;

  EvaluationOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;

  EvaluatedViews evaluated_views() const;
  // Returns how gld sample would draw the samples with this solver and guidance.
  SamplingMethod sampling_method() const;
};

// Runs the evaluation and writes the run folder (docs/FILES.md). A scene that is done is kept in scenes/, from where
// `resume` goes on. Several processes take a scene each in turns; rank 0 alone writes, after each turn. Returns the
// tables and the closing box as text, or nothing where another process writes the run folder.
std::string evaluate(const EvaluationOptions& options);

}  // namespace gld
