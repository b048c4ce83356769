#pragma once

#include "datasets/formats/scene_reader.h"
#include "gld/base/options.h"
#include "gld/flow/guidance.h"
#include "gld/flow/solvers/solver.h"
#include "gld/report/table.h"
#include "infer/pipeline/held_out_scenes.h"
#include "infer/pipeline/sampling_scene.h"
#include "models/losses/lpips_files.h"

#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace gld {

// The views of --scenes; generated scenes choose theirs.
struct BenchmarkViews : ViewSelection {
  void check() const override {}
};

// gld bench sample: latent error, image quality and time of sampling by solver, schedule, evaluations and guidance, of
// a scene's views or of generated scenes that training has not seen.
struct SampleBenchmarkOptions : OptionsGroup {
  std::string model = "configs/tiny";
  std::vector<std::string> scenes;  // folders
  int64_t max_scenes = 4;           // the first ones, by folder and path
  int64_t synthetic = 0;            // generated scenes, in the place of folders
  int64_t synthetic_seed = kHeldOutSeed;
  SceneReading reading;
  BenchmarkViews views;
  std::string size = "auto";
  int64_t seed = 0;
  std::vector<int64_t> counts{6, 12, 16, 20, 49};
  std::vector<double> guidance_scales{1, 1.5};
  double reference_tolerance = 1e-5;
  LpipsFiles lpips;
  std::string device = "cpu";
  int64_t threads = 0;
  std::string out;
  bool overwrite = false;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// One way to sample.
struct SamplingVariant {
  SolverOptions solver;
  GuidanceOptions guidance;
};

// The published sampler, the solvers on the log-SNR grid, and the default with cheaper guidance, for one scale.
std::vector<SamplingVariant> sampling_variants(const std::vector<int64_t>& counts, double guidance_scale);

// One scene sampled one way, or means over scenes.
struct SampleRow {
  std::string scene;
  std::string solver;    // "reference" for the converged solve that errors refer to
  std::string schedule;  // empty for the reference, which chooses its steps
  int64_t count = 0;     // function evaluations a level; 0 for the reference
  double guidance_scale = 1;
  std::string guidance;     // where and when the unconditional branch runs: "everywhere", "from t = 0.9", ...
  int64_t evaluations = 0;  // of both levels together
  int64_t unconditional = 0;  // of them with the unconditional branch
  // RMS of the latent's difference from the reference, over the reference's RMS, of the boundary level and of the
  // shallowest one; in tables level1_error and level0_error, what they are of the published model.
  double boundary_error = 0;
  double shallowest_error = 0;
  // Every metric of images by its name, means over the target views; one that is absent is left out.
  std::map<std::string, double> quality;
  double seconds = 0;      // of M1 and the cascade
  int64_t peak_bytes = 0;  // largest resident memory of a stage
  int64_t non_finite = 0;  // 1 where sampling stopped at a value that was not finite
  // On the Pareto front of seconds and shallowest_error, or of seconds and psnr, among the rows of its scene and scale.
  bool on_error_front = false;
  bool on_quality_front = false;

  bool is_reference() const { return count == 0; }
  double quality_of(const std::string& metric) const;  // NaN where absent
  // "unipc3, logsnr": what a plot calls it.
  std::string variant() const;
};

// Sets on_error_front and on_quality_front. The reference, failures and rows without a truth are left out.
void mark_pareto_fronts(std::vector<SampleRow>& rows);

Table sample_table(const std::vector<SampleRow>& rows);
// Means over scenes of the rows of one variant, guidance scale and count, with the fronts of the means.
std::vector<SampleRow> mean_over_scenes(const std::vector<SampleRow>& rows);

// Writes sample.csv, sample.md, sample.svg, sample.png and report.json into options.out. Returns the exit status.
int run_sample_benchmark(const SampleBenchmarkOptions& options);

}  // namespace gld
