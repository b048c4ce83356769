#pragma once

#include "datasets/formats/scene_reader.h"
#include "train/splats/splat_fit.h"

#include <cstdint>
#include <string>

namespace gld {

// gld splat fit: Gaussians of a scene, or of the sources and generated views of a run of gld sample.
struct SplatCommandOptions : OptionsGroup {
  std::string scene;
  std::string run;
  std::string out;
  bool overwrite = false;
  bool resume = false;
  int64_t side = 512;
  int64_t held_out = 0;
  int64_t validate_every = 0;
  int64_t checkpoint_every = 250;
  int64_t seed = 0;
  int64_t threads = 0;
  SceneReading reading;
  SplatFitOptions fit;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Where the Gaussians of a run folder are.
constexpr const char* kSplatFile = "splats.ply";

// The views of a scene as a fit takes them.
struct SplatFitViews {
  std::vector<SplatPicture> pictures;  // of those that are fitted, for the start
  std::vector<FittedView> fitted, held_out;
};
// Frames with pictures, resized and cropped to the first one's aspect with at most `side` pixels; held_out of them,
// evenly spread between the first and the last, are kept apart. Error where fewer than one is left to be fitted.
SplatFitViews load_fit_views(const Scene& scene, int64_t side, int64_t held_out,
                             const KernelSettings& settings);

// Mean squared errors of the views' pictures as dB, one a view.
std::vector<double> view_decibels(const std::vector<FittedView>& views, const GaussianSet& set,
                                  const ProjectionOptions& projection, const KernelSettings& settings);

// Writes splats.ply, cameras.json with the fitted views, pictures of held-out views, steps.csv and report.json into
// options.out. On Ctrl-C the Gaussians as far as they are fitted are written before it ends as interrupted. A run that
// was stopped or killed goes on with --resume, from its last checkpoint, and ends with the same bytes in splats.ply as
// one that was not.
void run_splat_fit(const SplatCommandOptions& options);

}  // namespace gld
