#pragma once

#include "infer/splats/latent_splatting.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// gld splat eval measures what Gaussians show of views that they were not fitted to, in colours and in a model's
// latents that its image decoder turns into pictures, as they are shown and, where the bundle has a refiner, as that
// repairs them (Splatent, arXiv 2512.09923, table 1).
struct SplatEvaluationOptions : ScenesSplattingOptions {
  // The model bundle whose backbone says how alike one place looks in two views, of scenes with depth; empty: that is
  // not measured.
  std::string consistency_model;

  void visit(FieldVisitor& visitor) override;
};

// Means over the held-out views of a scene. PSNR in dB, SSIM.
struct SplatScores {
  std::string scene;
  int64_t gaussians = 0;
  double rgb_psnr = 0, rgb_ssim = 0;          // of the Gaussians' colours
  double decoded_psnr = 0, decoded_ssim = 0;  // of latents as they show them, decoded
  // Of the Gaussians' colours, encoded as pictures and decoded: the rival that needs no latents on Gaussians.
  double encoded_colours_psnr = 0, encoded_colours_ssim = 0;
  double refined_psnr = 0, refined_ssim = 0;  // of those latents as the refiner repairs them, decoded
  double autoencoded_psnr = 0,
         autoencoded_ssim = 0;                // of latents as they are encoded, decoded: what can be reached
  double nearest_psnr = 0, nearest_ssim = 0;  // of the input view whose camera is nearest
  // Sharpness (gld/metrics), of the truth's.
  double rgb_sharpness = 0, decoded_sharpness = 0, refined_sharpness = 0, autoencoded_sharpness = 0;
  // Distance of random features (gld/metrics/random_features.h) from the truth.
  double rgb_random_features = 0, decoded_random_features = 0, encoded_colours_random_features = 0,
         refined_random_features = 0, autoencoded_random_features = 0;
  double latent_error = 0;           // models/splats/latent_fit.h, mean over levels
  double refined_error = 0;          // the same of what the refiner makes of them
  double encoded_colours_error = 0;  // the same of colours that are encoded
  // Energy of the high frequencies of latents over that of the encoded ones (gld/metrics/latent_spectrum.h).
  double high_band = 0, refined_high_band = 0;
  // met3r_like_true_geometry (gld/metrics/feature_consistency.h) of held-out views beside the view nearest to each, the
  // fitted ones being true pictures.
  double true_met3r_like = 0, rgb_met3r_like = 0, decoded_met3r_like = 0, encoded_colours_met3r_like = 0,
         refined_met3r_like = 0, autoencoded_met3r_like = 0;
  double seconds = 0;          // of fit and solve
  double refined_seconds = 0;  // of the refiner, a view
};

// Writes eval.csv (a row a scene), splat_eval.md, pictures/ and report.json into options.out.
void run_splat_evaluation(const SplatEvaluationOptions& options);

}  // namespace gld
