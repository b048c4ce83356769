#pragma once

#include "datasets/formats/scene_reader.h"
#include "datasets/splats/scene_fit.h"

#include <cstdint>
#include <string>

namespace gld {

// gld splat fit: Gaussians of a scene, or of the sources and generated views of a run of gld sample.
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

  void visit(FieldVisitor& visitor) override;
  void check() const override;
  const std::string& where() const { return run.empty() ? scene : run; }
};

// Writes splats.ply, cameras.json with the fitted views, pictures of held-out views, steps.csv and report.json into
// options.out. On Ctrl-C the Gaussians as far as they are fitted are written before it ends as interrupted. A run that
// was stopped or killed goes on with --resume, from its last checkpoint, and ends with the same bytes in splats.ply as
// one that was not.
void run_splat_fit(const SplatCommandOptions& options);

}  // namespace gld
