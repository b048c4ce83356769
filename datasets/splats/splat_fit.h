#pragma once

#include "datasets/splats/splat_start.h"
#include "gld/base/options.h"
#include "gld/splatting/density_control.h"
#include "gld/splatting/image_loss.h"
#include "gld/splatting/latent_view.h"

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace gld {

// What moves means, scales, rotations and opacities. Colours are always fitted, latents where they move geometry.
enum class SplatGeometryFrom { kRgb, kLatent, kBoth, kFixed };
inline bool moved_by_latents(SplatGeometryFrom from) {
  return from == SplatGeometryFrom::kLatent || from == SplatGeometryFrom::kBoth;
}
inline bool moved_by_colours(SplatGeometryFrom from) {
  return from == SplatGeometryFrom::kRgb || from == SplatGeometryFrom::kBoth;
}

// How Gaussians are fitted to pictures; what is not said otherwise is 3DGS's.
struct SplatFitOptions : OptionsGroup {
  int64_t steps = 2000;         // one view each
  int64_t degree = 3;           // of the spherical harmonics at last
  int64_t degree_every = 1000;  // steps after which one more degree is fitted
  double dissimilarity = 0.2;   // weight of 1 - SSIM beside the absolute difference
  SplatGeometryFrom geometry_from = SplatGeometryFrom::kRgb;
  ProjectionOptions projection;
  HeldAlphaGradient held_alpha_gradient = HeldAlphaGradient::kNone;
  SplatStartOptions start;
  SplatRates rates;
  DensityOptions density;

  SplatFitOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Throws Error where latents are to move the geometry, for a fit that has none.
void check_without_latents(const SplatFitOptions& options);

struct FittedView {
  std::string name;
  Camera camera;
  LossTarget target;
  LatentView latent;  // where latents move the geometry
};

// What is fitted, and where it stands: all that the next step depends on.
struct SplatFit {
  GaussianSet set;
  SplatMoments moments;
  DensityStatistics statistics;
  int64_t step = 0;  // done
  double extent = 1;
  SplatStartFrom start = SplatStartFrom::kDepth;  // what it began on
};

// Returns whether Gaussians are added during a fit that begins on that.
Densification settled_densification(const SplatFitOptions& options, SplatStartFrom start);
// Settles what options leave open, the near plane and whether Gaussians are added, for a fit that has begun.
void settle_fit_options(const SplatFit& fit, SplatFitOptions& options);

// Begins a fit before its first step, on what start_of() says, and settles options. where is the scene's name in
// errors. The result does not depend on settings.threads.
SplatFit begin_splat_fit(const std::vector<SplatPicture>& pictures,
                         const std::vector<Eigen::Vector3d>& points_in_world, SplatFitOptions& options,
                         const std::string& where, const KernelSettings& settings);

// Begins the features with which latents begin to move the geometry: those that show the views' latents best from the
// Gaussians as they stand (solve_features). Where they do not move it, it does nothing.
void begin_features(const std::vector<FittedView>& views, const SplatFitOptions& options,
                    const KernelSettings& settings, SplatFit& fit);

struct SplatFitStep {
  int64_t step = 0;  // from 1
  double loss = 0, absolute = 0, similarity = 0;
  double latent = 0;  // mean |rendered - encoded|, in deviations of a channel, where latents move geometry
  int64_t gaussians = 0;
  int64_t seen = 0;  // of the step's view
  DensityChange change;
};

// Does one step: the view whose turn it is (every view once a round, in an order of the round's own that seed decides),
// its loss, its gradients, Adam, density. Where latents move geometry their mean absolute difference is added to the
// loss. The result does not depend on settings.threads. views is not empty.
SplatFitStep splat_fit_step(const std::vector<FittedView>& views, const SplatFitOptions& options,
                            uint64_t seed, const KernelSettings& settings, SplatFit& fit);

}  // namespace gld
