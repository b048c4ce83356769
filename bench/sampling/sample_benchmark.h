#pragma once

#include "datasets/formats/scene_reader.h"
#include "datasets/scenes/view_sampling.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/options.h"
#include "infer/request/sampling_scene.h"
#include "models/losses/lpips_files.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// These frames are views in every scene; where there are none, views are drawn.
struct BenchmarkViews : ViewSelection {
  void check() const override;
};

// gld bench sample measures error against run time of every way to sample a scene (solvers, counts, what is left out,
// precisions), each against a converged solve of the same noise.
struct SampleBenchmarkOptions : OptionsGroup {
  std::string model = "configs/tiny";
  std::vector<std::string> scenes;  // folders
  int64_t max_scenes = 4;           // the first ones, by folder and path
  int64_t synthetic = 0;            // generated scenes, in the place of folders
  int64_t synthetic_seed = 888000;  // neither training nor gld eval uses it
  SyntheticOptions generator;
  SceneReading reading;
  BenchmarkViews views;
  ViewSampling drawn_views;
  std::string size = "auto";
  std::vector<int64_t> counts{6, 8, 10, 12, 16, 20, 24};
  std::vector<double> guidance_scales{1.5};
  std::vector<std::string> families;    // of ComparedMethod beside "fewer evaluations"; empty for all
  std::vector<std::string> precisions;  // beside float32
  int64_t reference_evaluations = 64;
  double reference_tolerance = 0;
  int64_t repeats = 2;
  int64_t workers = 0;
  bool write_table = false;
  LpipsFiles lpips;
  int64_t seed = 0;
  std::string device = "cpu";
  int64_t threads = 0;
  std::string out;
  bool overwrite = false;

  SampleBenchmarkOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Writes sample.csv (every sample), methods.csv, sample.md, .svg, .png, plan_errors.json and report.json into
// options.out, and plan_errors.json into the bundle with write_table. Returns the exit status.
int run_sample_benchmark(const SampleBenchmarkOptions& options);

}  // namespace gld
