#pragma once

#include "infer/splats/latent_splatting.h"

namespace gld {

// gld splat pairs makes what a refiner is trained on. Of each scene Gaussians are fitted to some views and show the
// others, by features of latents and by colours that are encoded, which are kept beside the encoded ones
// (models/splats/splatted_scene.h).
struct SplatPairsOptions : ScenesSplattingOptions {
  bool resume = false;

  SplatPairsOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Writes pairs/ with a file a scene, pairs.csv with the error of each, and report.json into options.out. With resume
// scenes whose file is there already are left as they are.
void run_splat_pairs(const SplatPairsOptions& options);

}  // namespace gld
