#pragma once

#include "gld/base/options.h"
#include "gld/splatting/compositing.h"

#include <cstdint>
#include <vector>

namespace gld {

// Features of Gaussians whose geometry is fixed are linear least squares. With W the weights of all views' pixels and
// t = W^T W 1, each Gaussian's total weight, minimise
//   |W f - pictures|^2 + ridge sum over Gaussians t |f - m|^2,
// m being the mean of what the pictures show of the Gaussian, by weight. Gaussians closer than a pixel are nearly equal
// columns of W, which the pictures do not tell apart: what they leave open is decided by the ridge. Features that
// depend on the direction of view (feature_harmonics.h) have a column for each of their coefficients, W b_k; m and t
// are those of b_0, and the m of the others is 0.
struct FeatureSolveOptions : OptionsGroup {
  double tolerance =
      1e-6;  // of the residual of that problem's normal equations, relative to their right side
  int64_t most_iterations = 1000;
  double ridge = 1e-2;         // of t
  int64_t feature_degree = 0;  // of features' spherical harmonics; the published code of Splatent has 2

  void visit(FieldVisitor& visitor) override;
};

struct FeatureView {
  SplatView view;
  SplatImage picture;
};

struct SolvedFeatures {
  std::vector<float> features;    // (gaussians, coefficients, channels); 0 for those that no view shows
  std::vector<double> residuals;  // before the first iteration and after each, of the worst channel

  int64_t iterations() const { return static_cast<int64_t>(residuals.size()) - 1; }
};
// Solves by conjugate gradients from m, 64 channels at once with steps of their own, preconditioned by |W|^T |W| 1,
// which bounds the normal equations' rows. W is made once, as a sparse matrix by rows and by columns. The result does
// not depend on settings.threads. views are of the set, their pictures have one number of channels. Throws Error for no
// view.
SolvedFeatures solve_features(const std::vector<FeatureView>& views, const GaussianSet& set,
                              const FeatureSolveOptions& options, const KernelSettings& settings);

}  // namespace gld
