#pragma once

#include "infer/splats/latent_splatting.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// gld splat eval measures what Gaussians show of views that they were not fitted to, in colours and in a model's
// latents that its image decoder turns into pictures: as features show them, as colours do that are encoded, and, where
// the bundle has a refiner, as that repairs the one or the other (Splatent, arXiv 2512.09923, table 1).
struct SplatEvaluationOptions : ScenesSplattingOptions {
  // The model bundle whose backbone says how alike one place looks in two views, of scenes with depth; empty: that is
  // not measured.
  std::string consistency_model;

  void visit(FieldVisitor& visitor) override;
};

// Writes eval.csv (a row a scene), splat_eval.md, pictures/ and report.json into options.out.
void run_splat_evaluation(const SplatEvaluationOptions& options);

}  // namespace gld
