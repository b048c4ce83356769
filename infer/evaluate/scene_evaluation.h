#pragma once

#include "gld/metrics/metric.h"
#include "infer/evaluate/pose_estimation.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "infer/pipeline/sampling_scene.h"
#include "models/bundle/bundle.h"
#include "models/losses/lpips.h"

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// Whose images are compared with the true ones.
enum class Predictor {
  kSample,          // a sample of the model, as gld sample draws it
  kMeanPrediction,  // the model's prediction of the mean, mean_prediction_settings
  // Trivial ones, which know the sources only:
  kNearestSource,  // the source whose camera is nearest, copied
  kMeanSource,     // pixel by pixel mean of the sources
  kMeanColor,      // the mean colour of the sources
  // All views, sources too, encoded and decoded: what the decoder can do at best.
  kReconstruction,
  // The same with one level alone, the others zero: what a level holds of the picture (GLD's Table 6). It says something of
  // the level only where the decoder was trained with levels left out.
  kReconstructionLevel0,
  kReconstructionLevel1,
  kReconstructionLevel2,
  kReconstructionLevel3,
};
const std::vector<Predictor>& all_predictors();
const std::vector<Predictor>& main_predictors();  // without those of one level
const std::vector<Predictor>& trivial_predictors();
std::string predictor_name(Predictor predictor);  // "mean_prediction"

// A number that gld eval reports of every scene: a metric of a predictor's images ("sample_psnr", "mean_prediction_psnr",
// "psnr_nearest_source", "reconstruction_psnr"), or one of the sample's geometry under the metric's own name
// ("depth_abs_rel_unscaled").
struct EvaluationColumn {
  std::string name;
  Metric metric;
  Predictor of = Predictor::kSample;
};
const std::vector<EvaluationColumn>& evaluation_columns();

// The mean of a metric over a scene's target views, then over its samples, or why there is none.
struct SceneNumber {
  double value = 0;            // NaN where absent; a perfect prediction's PSNR is infinite
  std::string absent;          // in every sample
  int64_t absent_samples = 0;  // samples without a value, of several, where others have one
  // By sample, one value a target, NaN for a target without one; empty where the metric is of the whole scene. Numbers that do
  // not depend on the sample have one.
  std::vector<std::vector<double>> of_targets = {};
};

struct SceneEvaluation {
  std::string scene;
  int64_t samples = 1;
  std::vector<std::string> sources;  // names of frames
  std::vector<std::string> targets;
  std::vector<SceneNumber> numbers;  // in the order of evaluation_columns

  // By the name of its column. Throws Error for a name that is none.
  const SceneNumber& number(const std::string& column) const;
  // Whether the PSNR of a trivial predictor is below that of the sample.
  bool sample_beats(Predictor trivial) const;
  bool sample_beats_every_trivial() const;
};

// The numbers of a scene and what they were measured on.
struct EvaluatedScene {
  SceneEvaluation evaluation;
  PipelineResult sample;  // the first one
  PipelineResult mean_prediction;
};

// What all scenes share.
struct EvaluationModels {
  BundleOptions bundle;
  PipelineModels models;
  std::shared_ptr<Lpips> lpips;  // null without weights
  torch::Device device = torch::kCPU;
  PoseEstimator poses = PoseEstimator::kOurs;
  // Whose geometry head looks at the sources and the generated pictures, for poses; the model's own reads the levels.
  std::optional<PipelineModels> pose_model;
};

// Draws a sample from the noise of each seed, predicts the mean from that of the first, and measures both. sampling: how
// samples are drawn. At least one seed.
EvaluatedScene evaluate_scene(const EvaluationModels& models, const SamplingScene& scene,
                              const FlowSettings& sampling, const std::vector<int64_t>& noise_seeds);

}  // namespace gld
