#pragma once

#include "gld/metrics/metric.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "infer/pipeline/sampling_scene.h"
#include "models/bundle/bundle.h"
#include "models/losses/lpips.h"

#include <cstdint>
#include <memory>
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
};
const std::vector<Predictor>& all_predictors();
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

// The mean of a metric over a scene's target views, or why there is none.
struct SceneNumber {
  double value = 0;  // NaN where absent; a perfect prediction's PSNR is infinite
  std::string absent;
};

struct SceneEvaluation {
  std::string scene;
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
  PipelineResult sample;
  PipelineResult mean_prediction;
};

// What all scenes share.
struct EvaluationModels {
  BundleOptions bundle;
  PipelineModels models;
  std::shared_ptr<Lpips> lpips;  // null without weights
  torch::Device device = torch::kCPU;
};

// Draws a sample and predicts the mean from the noise of that seed, and measures both. sampling: how the sample is drawn.
EvaluatedScene evaluate_scene(const EvaluationModels& models, const SamplingScene& scene,
                              const FlowSettings& sampling, int64_t noise_seed);

}  // namespace gld
