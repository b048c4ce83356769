#pragma once

#include "gld/metrics/metric.h"
#include "infer/evaluate/evaluation_columns.h"
#include "infer/evaluate/evaluation_models.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "infer/request/sampling_scene.h"

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace gld {

// The mean of a metric over a scene's target views, then over its samples, or why there is none; of a metric of all
// samples together its mean over target views.
struct SceneNumber {
  double value = 0;            // NaN where absent; a perfect prediction's PSNR is infinite
  std::string absent;          // in every sample
  int64_t absent_samples = 0;  // samples without a value, of several, where others have one
  // By sample, one value a target, NaN for a target without one; empty where the metric is of the whole scene. Numbers
  // that do not depend on the sample have one.
  std::vector<std::vector<double>> of_targets = {};
};

struct SceneEvaluation {
  std::string scene;
  int64_t samples = 1;
  std::vector<std::string> sources;  // names of frames
  std::vector<std::string> targets;
  std::vector<SceneNumber> numbers;  // in the order of evaluation_columns

  // Returns the number by the name of its column. Throws Error for a name that is none.
  const SceneNumber& number(const std::string& column) const;
  // Returns whether the PSNR of a trivial predictor is below that of the sample.
  bool sample_beats(const Predictor& trivial) const;
  // Returns whether the sample's number of a metric that is better higher or lower is better than another predictor's;
  // nothing where either has none.
  std::optional<bool> sample_wins(const Predictor& other, const Metric& metric) const;
  bool sample_beats_every_trivial() const;
};

// The numbers of a scene and what they were measured on.
struct EvaluatedScene {
  SceneEvaluation evaluation;
  PipelineResult sample;  // the first one
  PipelineResult mean_prediction;
  // What the decoder makes of the first target view's true features, (3, height, width): of all levels that it takes,
  // and where they are several of each alone; empty where a target has no picture. The first of a pair is the level.
  std::vector<std::pair<std::optional<int64_t>, torch::Tensor>> first_reconstructed;
};

// Draws a sample from the noise of each seed, predicts the mean from that of the first, and measures both. sampling
// says how samples are drawn. There is at least one seed.
EvaluatedScene evaluate_scene(const EvaluationModels& models, const SamplingScene& scene,
                              const FlowSettings& sampling, const std::vector<int64_t>& noise_seeds);

}  // namespace gld
