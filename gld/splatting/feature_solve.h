#pragma once

#include "gld/base/options.h"
#include "gld/splatting/compositing.h"

#include <cstdint>
#include <vector>

namespace gld {

// Features of Gaussians whose geometry is fixed are linear least squares: with W the weights of a view's pixels,
// minimise sum over views |W f - picture|^2 + ridge sum over Gaussians (total weight) |f|^2.
struct FeatureSolveOptions : OptionsGroup {
  double tolerance = 1e-6;  // of the residual of the normal equations, relative to its first
  int64_t most_iterations = 200;
  double ridge = 1e-6;

  void visit(FieldVisitor& visitor) override;
};

struct FeatureView {
  SplatView view;
  SplatImage picture;
};

struct SolvedFeatures {
  std::vector<float> features;    // (gaussians, channels); 0 for those that no view shows
  std::vector<double> residuals;  // after each iteration, of the worst channel
};
// By conjugate gradients, all channels at once with steps of their own, preconditioned by each Gaussian's total weight
// W^T W 1, which bounds the diagonal. Pictures have one number of channels. Error for no view.
SolvedFeatures solve_features(const std::vector<FeatureView>& views, int64_t gaussians,
                              const FeatureSolveOptions& options, const KernelSettings& settings);

}  // namespace gld
