#pragma once

#include "datasets/scenes/scene.h"
#include "gld/report/table.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

struct SplatErrorSettings {
  std::vector<int64_t> gaussians{2500, 5000, 10000, 20000};
  std::vector<int64_t> steps{50, 100, 200, 400, 800};  // rising
  int64_t side = 128;                                  // of pictures
  int64_t held_out = 5;
  int64_t feature_side = 64;  // of pictures of features
  int64_t channels = 32;
  std::vector<int64_t> iterations{1, 2, 5, 10, 20, 40, 80, 160, 320};  // of conjugate gradients, rising
  double ridge = 1e-2;                                                 // FeatureSolveOptions
  std::vector<int64_t> adam_steps{50, 200, 800};
  std::vector<double> adam_rates{0.02, 0.1};  // at first; at last a hundredth
  // Bounds of what is drawn, one at a time, the other as ProjectionOptions has it.
  std::vector<double> least_alphas{1.0 / 4080, 1.0 / 255, 1.0 / 64, 1.0 / 16};
  std::vector<double> least_transmittances{1e-6, 1e-4, 1e-2, 1e-1};
  int64_t repeats = 7;  // of a picture whose time is measured
  int threads = 1;
};

// A fit in colours after some of its steps.
struct SplatFitRow {
  int64_t gaussians = 0;
  int64_t steps = 0;
  double seconds = 0;
  double fitted_psnr = 0, held_out_psnr = 0;  // dB
};
std::vector<SplatFitRow> splat_fit_rows(const Scene& scene, const SplatErrorSettings& settings);
Table splat_fit_table(const std::vector<SplatFitRow>& rows);

// A finished fit, drawn with bounds of its own.
struct SplatBoundRow {
  double least_alpha = 0, least_transmittance = 0;  // ProjectionOptions
  double milliseconds = 0;                          // a picture of held-out views, median
  double error = 0;          // root mean square of what differs from the picture without bounds
  double held_out_psnr = 0;  // dB
};
std::vector<SplatBoundRow> splat_bound_rows(const Scene& scene, const SplatErrorSettings& settings);
Table splat_bound_table(const std::vector<SplatBoundRow>& rows);

// Features of Gaussians whose geometry is fixed, fitted to pictures of functions of the place in the world.
struct SplatFeatureRow {
  std::string method;  // "conjugate_gradients", "adam_0.02"
  int64_t gaussians = 0;
  int64_t steps = 0;  // conjugate gradients: of all views; Adam: of one view
  double seconds = 0;
  // |W (f - f*)| / |pictures|, f* being what conjugate gradients end with.
  double error = 0;
  double residual = 0;  // of the normal equations, relative to its first; conjugate gradients only
};
std::vector<SplatFeatureRow> splat_feature_rows(const Scene& scene, const SplatErrorSettings& settings);
Table splat_feature_table(const std::vector<SplatFeatureRow>& rows);

}  // namespace gld
