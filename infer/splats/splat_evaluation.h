#pragma once

#include "datasets/splats/scene_fit.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/splatting/feature_solve.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// gld splat eval: what Gaussians show of views that they were not fitted to, in colours and in a model's latents that
// its image decoder turns into pictures (the baselines of Splatent, arXiv 2512.09923, table 1, without its refiner).
struct SplatEvaluationOptions : OptionsGroup {
  std::vector<std::string> scenes;
  int64_t synthetic = 8;       // drawn rooms where no scenes are given
  int64_t synthetic_seed = 0;  // theirs
  SyntheticOptions generator;
  std::string model = "configs/tiny";
  std::string out;
  bool overwrite = false;
  int64_t side = 256;       // pixels of a picture's longer side at most, in whole patches of the model
  int64_t held_out = 5;     // views that are compared with, evenly spread
  int64_t input_views = 0;  // of the others, evenly spread; 0: all
  int64_t seed = 0;
  int64_t threads = 0;
  SplatFitOptions fit;
  FeatureSolveOptions solve;

  SplatEvaluationOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Means over the held-out views of a scene. PSNR in dB, SSIM.
struct SplatScores {
  std::string scene;
  int64_t gaussians = 0;
  double rgb_psnr = 0, rgb_ssim = 0;          // of the Gaussians' colours
  double decoded_psnr = 0, decoded_ssim = 0;  // of latents as they show them, decoded
  double autoencoded_psnr = 0,
         autoencoded_ssim = 0;                // of latents as they are encoded, decoded: what can be reached
  double nearest_psnr = 0, nearest_ssim = 0;  // of the input view whose camera is nearest
  double latent_error = 0;                    // models/splats/latent_fit.h, mean over levels
  double seconds = 0;                         // of fit and solve
};

// Writes eval.csv (a row a scene), splat_eval.md, pictures/ and report.json into options.out.
void run_splat_evaluation(const SplatEvaluationOptions& options);

}  // namespace gld
