#pragma once

#include "gld/metrics/metric.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// Whose images are compared with the true ones.
struct Predictor {
  enum Kind {
    kSample,          // a sample of the model, as gld sample draws it
    kMeanPrediction,  // the model's prediction of the mean, mean_prediction_settings
    // The next three are trivial ones, which know the sources only.
    kNearestSource,  // the source whose camera is nearest, copied
    kMeanSource,     // pixel by pixel mean of the sources
    kMeanColor,      // the mean colour of the sources
    // The sources carried into the target by their depth, as a model with warped_sources is shown them, and for depth
    // that of the nearest source as the target sees it (models/scene_geometry/source_warp.h). Not trivial: it takes
    // the model's depth, but nothing is generated.
    kWarpedSources,
    // The same kept at the photographs' own resolution, and gaps filled smoothly from around them: what a generated
    // part has to beat.
    kFill,
    // The filled pictures encoded beside the sources and decoded: what the decoder alone costs a generator that has
    // nothing to add. What a sample has over it is what was learnt.
    kReconstructedFill,
    // The filled pictures by the true depth of the sources: how much of what samples miss is the depth that carries
    // photographs.
    kFillByTrueDepth,
    // The sample before what photographs show was kept in it.
    kGenerated,
    // All views, sources too, encoded and decoded: what the decoder can do at best.
    kReconstruction,
    // The same with one level alone, the others zero: what a level holds of the picture (GLD's Table 6). It says
    // something of the level only where the decoder was trained with levels left out.
    kReconstructionOfLevel,
    // The prediction of the mean where deeper levels are the true ones: what a cascade makes of a level when what it is
    // given is right. It has latents and no images.
    kFromTrueLevels,
  };
  Kind kind = kSample;
  int64_t level = 0;  // of kReconstructionOfLevel

  Predictor(Kind which, int64_t level_alone = 0) : kind(which), level(level_alone) {}
  bool operator==(const Predictor& other) const { return kind == other.kind && level == other.level; }
  bool operator!=(const Predictor& other) const { return !(*this == other); }
  // Returns true for reconstructions, which are of all views and not of the targets alone.
  bool of_all_views() const { return kind == kReconstruction || kind == kReconstructionOfLevel; }
};
const std::vector<Predictor>& all_predictors();
const std::vector<Predictor>& main_predictors();  // without those of one level
// Returns those of one level alone, by level: there are four columns, whatever backbone there is, because files have as
// many.
const std::vector<Predictor>& level_predictors();
const std::vector<Predictor>& trivial_predictors();
bool is_trivial(const Predictor& predictor);
std::string predictor_name(const Predictor& predictor);  // "mean_prediction", "reconstruction_level0"

// Returns what samples are compared with room by room: everything that does not generate, and the mean prediction.
// These are more than the trivial predictors, which know nothing of the model.
const std::vector<Predictor>& rivals();
// Returns the metrics by which they are compared: PSNR and the energy scores, of all pixels, of those that photographs
// show and of the others.
const std::vector<Metric>& compared_metrics();

// Returns whether a metric has a column for each predictor, as those of images and of samples have.
bool of_every_predictor(const Metric& metric);

// A number that gld eval reports of every scene: a metric of a predictor's images ("sample_psnr",
// "mean_prediction_psnr", "psnr_nearest_source", "reconstruction_psnr", "fill_energy_score"), or one of the sample's
// geometry under the metric's own name ("depth_abs_rel_unscaled"), or of the depth of warped sources
// ("warped_sources_depth_abs_rel_unscaled"), or of latents ("sample_latent_error_level0",
// "from_true_levels_latent_error_level0").
struct EvaluationColumn {
  std::string name;
  Metric metric;
  Predictor of = Predictor::kSample;
};
const std::vector<EvaluationColumn>& evaluation_columns();
// Returns the name for a metric that every predictor has, as above.
std::string column_name(const Predictor& predictor, const Metric& metric);

}  // namespace gld
