#pragma once

#include "gld/base/options.h"
#include "gld/splatting/compositing.h"
#include "gld/splatting/splat_adam.h"

#include <cstdint>
#include <vector>

namespace gld {

enum class Densification {
  kNone,
  kPublished,  // 3DGS's
  kAuto,       // as what a fit begins on wants it: to be settled before the first step, else none
};

// Where Gaussians are added and removed during a fit; the defaults are 3DGS's.
struct DensityOptions : OptionsGroup {
  Densification densify = Densification::kAuto;
  int64_t most_gaussians = 100000;
  double gradient = 2e-4;      // mean length of d loss / d place in the picture, which is 2 wide and high
  double dense_scale = 0.01;   // of the scene's extent: what is larger is split, what is smaller copied
  double faintest = 0.005;     // opacity below which a Gaussian is removed
  double largest_scale = 0.1;  // of the scene's extent: removed where larger, after the first reset
  int64_t first_step = 500;
  int64_t last_step = 15000;  // or last_density_step()
  int64_t every = 100;
  int64_t reset_every = 3000;  // opacities above 0.01 are set to it, where as many steps follow

  void visit(FieldVisitor& visitor) override;
};

// What is gathered between two changes. The published sums are reset at every change, here as well.
struct DensityStatistics {
  std::vector<float> gradient_sums;  // a Gaussian
  std::vector<int32_t> seen;         // views
};
void gather(const SplatView& view, const ColourGradients& gradients, int64_t gaussians,
            DensityStatistics& statistics);

// Returns the last step at which Gaussians are added or removed in a fit of so many: `every` steps before its end at
// the latest, since what was added has to find its place.
int64_t last_density_step(const DensityOptions& options, int64_t steps);

struct DensityStep {
  int64_t step = 0;   // of the fit, from 1
  int64_t steps = 0;  // of how many
  double extent = 1;  // of the scene
  uint64_t seed = 0;  // of where the halves of a Gaussian that is split go
};
struct DensityChange {
  int64_t copied = 0, split = 0, removed = 0;
  bool reset = false;
};
// Does what the options ask for at a step, in the set and in its moments, which are 0 for new Gaussians. Where the cap
// leaves no room for all, those with the largest gradient go first, of equal ones the lower index. The statistics start
// anew where Gaussians were looked at.
DensityChange control_density(const DensityOptions& options, const DensityStep& step,
                              DensityStatistics& statistics, GaussianSet& set, SplatMoments& moments);

}  // namespace gld
