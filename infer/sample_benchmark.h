#pragma once

#include "datasets/scene_reader.h"
#include "gld/guidance.h"
#include "gld/options.h"
#include "gld/solver.h"
#include "gld/table.h"
#include "infer/sampling_scene.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// gld bench sample: latent error, image quality and time of sampling by solver, schedule, evaluations and guidance.
struct SampleBenchmarkOptions : OptionsGroup {
  std::string model = "configs/tiny";
  std::string scene;       // a scene, or a folder of scenes
  int64_t max_scenes = 4;  // the first ones, by path
  SceneReading reading;
  ViewSelection views;
  std::string size = "auto";
  int64_t seed = 0;
  std::vector<int64_t> counts{6, 12, 16, 20, 49};
  std::vector<double> guidance_scales{1, 1.5};
  double reference_tolerance = 1e-5;
  std::string device = "cpu";
  int64_t threads = 0;
  std::string out;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// One way to sample.
struct SamplingVariant {
  std::string name;  // "unipc3, logsnr": what a plot calls it, without the number of evaluations
  SolverOptions solver;
  GuidanceOptions guidance;
};

// The published sampler, the solvers on the log-SNR grid, and the default with cheaper guidance, for one scale.
std::vector<SamplingVariant> sampling_variants(const std::vector<int64_t>& counts, double guidance_scale);

// One scene sampled one way, or means over scenes.
struct SampleRow {
  std::string scene;
  std::string variant;
  double guidance_scale = 1;
  int64_t evaluations = 0;    // of both levels together
  int64_t unconditional = 0;  // of them with the unconditional branch
  double level1_error = 0;    // RMS of the latent's difference from the reference, over the reference's RMS
  double level0_error = 0;
  double psnr = 0;  // of the target views in dB; NaN without truth
  double ssim = 0;
  double seconds = 0;      // of M1 and the cascade
  int64_t peak_bytes = 0;  // largest resident memory of a stage
  int64_t non_finite = 0;  // 1 where sampling stopped at a value that was not finite
};

Table sample_table(const std::vector<SampleRow>& rows);
// Means over scenes of the rows with the same variant, guidance scale and evaluations.
std::vector<SampleRow> mean_over_scenes(const std::vector<SampleRow>& rows);

// Writes sample.csv, sample.md, sample.svg, sample.png and report.json into options.out. Returns the exit status.
int run_sample_benchmark(const SampleBenchmarkOptions& options);

}  // namespace gld
