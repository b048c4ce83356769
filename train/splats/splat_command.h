#pragma once

#include "datasets/formats/scene_reader.h"
#include "datasets/splats/scene_fit.h"
#include "gld/report/run_folder.h"
#include "gld/splatting/feature_solve.h"

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// gld splat fit makes Gaussians of a scene, or of the sources and generated views of a run of gld sample.
struct SplatCommandOptions : SceneFitOptions {
  std::string scene;
  std::string run;
  std::string out;
  bool overwrite = false;
  bool resume = false;
  int64_t validate_every = 0;
  int64_t checkpoint_every = 250;
  int64_t threads = 0;
  SceneReading reading;
  std::vector<std::string> features{"none"};
  std::string model = "configs/tiny";
  FeatureSolveOptions solve;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
  const std::string& where() const { return run.empty() ? scene : run; }
  bool has_features() const;
};

// A fit whose steps are all done, with splats.ply written.
struct FinishedSplatFit {
  const GaussianSet& set;
  const ProjectionOptions& projection;
  const Scene& scene;
  const KernelSettings& settings;
  RunFolder& run;
  nlohmann::ordered_json& report;  // which is written afterwards
};
// What this part of the program, which has no LibTorch, does not know (splat_features.h).
struct SplatFitLatents {
  // Gives every view its latent before the fit, where latents move its geometry.
  std::function<void(const Scene& scene, SplatFitViews& views)> before;
  // Adds to the run and its report after it.
  std::function<void(const FinishedSplatFit&)> after;
};

// Writes splats.ply, cameras.json with the fitted views, pictures of held-out views, steps.csv and report.json into
// options.out. On Ctrl-C the Gaussians as far as they are fitted are written before it ends as interrupted. A run that
// was stopped or killed goes on with --resume, from its last checkpoint, and ends with the same bytes in splats.ply as
// one that was not.
void run_splat_fit(const SplatCommandOptions& options, const SplatFitLatents& latents = {});

}  // namespace gld
