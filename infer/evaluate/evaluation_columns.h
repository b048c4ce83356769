#pragma once

#include "gld/metrics/metric.h"

#include <string>
#include <vector>

namespace gld {

// Whose images are compared with the true ones.
enum class Predictor {
  kSample,          // a sample of the model, as gld sample draws it
  kMeanPrediction,  // the model's prediction of the mean, mean_prediction_settings
  // Trivial ones, which know the sources only:
  kNearestSource,  // the source whose camera is nearest, copied
  kMeanSource,     // pixel by pixel mean of the sources
  kMeanColor,      // the mean colour of the sources
  // The sources carried into the target by their depth, as a model with warped_sources is shown them, and for depth
  // that of the nearest source as the target sees it (models/scene_geometry/source_warp.h). Not trivial: it takes the
  // model's depth, but nothing is generated.
  kWarpedSources,
  // All views, sources too, encoded and decoded: what the decoder can do at best.
  kReconstruction,
  // The same with one level alone, the others zero: what a level holds of the picture (GLD's Table 6). It says
  // something of the level only where the decoder was trained with levels left out.
  kReconstructionLevel0,
  kReconstructionLevel1,
  kReconstructionLevel2,
  kReconstructionLevel3,
};
const std::vector<Predictor>& all_predictors();
const std::vector<Predictor>& main_predictors();  // without those of one level
// Those of one level alone, by level: four columns, whatever backbone there is.
const std::vector<Predictor>& level_predictors();
const std::vector<Predictor>& trivial_predictors();
bool is_trivial(Predictor predictor);
std::string predictor_name(Predictor predictor);  // "mean_prediction"

// A number that gld eval reports of every scene: a metric of a predictor's images ("sample_psnr",
// "mean_prediction_psnr", "psnr_nearest_source", "reconstruction_psnr"), or one of the sample's geometry under the
// metric's own name ("depth_abs_rel_unscaled"), or of the depth of warped sources
// ("warped_sources_depth_abs_rel_unscaled").
struct EvaluationColumn {
  std::string name;
  Metric metric;
  Predictor of = Predictor::kSample;
};
const std::vector<EvaluationColumn>& evaluation_columns();
// Of a metric of a predictor's images, as above.
std::string column_name(Predictor predictor, const Metric& metric);

}  // namespace gld
