#pragma once

#include "datasets/scenes/view_sampling.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/options.h"
#include "gld/flow/guidance.h"
#include "gld/flow/solvers/solver.h"
#include "infer/pipeline/held_out_scenes.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// gld eval: novel views of scenes with known truth.
struct EvaluationOptions : OptionsGroup {
  std::string model = "configs/tiny";
  std::string out;
  int64_t synthetic = 64;                 // generated scenes; 0 when scenes are given
  int64_t synthetic_seed = kHeldOutSeed;  // training and validation use others
  std::vector<std::string> scenes;        // folders; empty: generated ones
  SyntheticOptions generator;             // what the generated scenes look like
  ViewSampling views;
  SolverOptions solver;
  GuidanceOptions guidance;
  int64_t seed = 0;  // of the noise
  int64_t pictures = 6;
  std::string device = "cpu";
  int64_t threads = 0;

  EvaluationOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// The numbers of one scene. PSNRs are means over target views in dB; the trivial predictors are given the sources only.
struct SceneEvaluation {
  std::string scene;
  double psnr = 0;
  double psnr_nearest_source = 0;  // the source whose camera is nearest, copied
  double psnr_mean_source = 0;     // pixel by pixel mean of the sources
  double psnr_mean_color = 0;      // the mean colour of the sources
  double ssim = 0;
  double depth_abs_rel = 0;        // decoded target depth after one scale a scene; NaN without true depth
  double reconstruction_psnr = 0;  // all views encoded and decoded
};

struct MeanWithInterval {
  double mean = 0;
  double half_width = 0;  // of the 95 % confidence interval, 1.96 standard errors
  int64_t count = 0;      // finite values
};
// Values that are not finite are left out; a mean of nothing is NaN.
MeanWithInterval mean_with_interval(const std::vector<double>& values);

// eval.csv: the header and one row a scene, numbers with 6 digits.
std::string evaluation_csv(const std::vector<SceneEvaluation>& scenes);
// Means with intervals, the best trivial predictor and the margin over it.
nlohmann::ordered_json evaluation_summary(const std::vector<SceneEvaluation>& scenes);

// Runs the evaluation and writes the run folder: eval.csv, report.json, sheets/. Returns the table and the closing box
// as text.
std::string evaluate(const EvaluationOptions& options);

}  // namespace gld
