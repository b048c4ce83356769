#pragma once

#include "gld/base/options.h"

#include <cstdint>
#include <vector>

namespace gld {

// How the degraded view and its references see each other in every attention over pixels (Splatent, table 4).
enum class ViewAttention {
  kGrid,   // as one picture of all views: convolutions cross the borders of its cells as well
  kSelf,   // the tokens of all views joined; everything else is per view
  kCross,  // the degraded view looks at the references alone, each reference at itself
};

// What one evaluation makes of a latent (one_step_update.h).
enum class OneStepForm {
  kIdentity,   // z + sqrt((1 - a) / a) e: where the network gives 0 nothing changes
  kPublished,  // (z - sqrt(1 - a) e) / sqrt(a), of checkpoints of Stable Diffusion's shape
};

// What a refiner repairs: of a view that no Gaussian was fitted to, or of a target view.
enum class DegradedLatents {
  kSplatted,   // latents as features of Gaussians show them (Splatent)
  kColours,    // what the Gaussians' colours show, encoded (Difix3D+, arXiv 2503.01774)
  kGenerated,  // all levels that flows of few evaluations generate (models/refiner/stacked_levels.h)
};

// What distances between cameras are measured in when references are chosen (reference_views.h).
enum class ReferenceUnit {
  kSpacing,  // the mean distance of a camera from the one nearest to it: the same for a scene of any unit
  kScene,    // the scene's own unit (Splatent's code)
};

// Of the one-step refiner (Splatent, arXiv 2512.09923, section 4.3). The defaults are a small model's.
struct RefinerOptions : OptionsGroup {
  std::vector<int64_t>
      channels;                  // of the UNet's stages, each but the last halves the sides; none: no refiner
  std::vector<int64_t> heads;    // of attention in each stage
  int64_t attending_stages = 3;  // the first so many attend over pixels; the middle always does
  int64_t layers_per_block = 1;  // residual blocks of a stage on the way down; one more on the way up
  int64_t norm_groups = 32;
  int64_t latent_channels = 4;
  int64_t prompt_tokens = 1;  // constant tokens in the place of a text, seen by every attention's second half
  int64_t prompt_channels = 64;
  int64_t timestep = 300;  // tau, of 1000: how noisy the network is told that the latent is
  OneStepForm form = OneStepForm::kIdentity;
  ViewAttention attention = ViewAttention::kGrid;

  DegradedLatents degraded = DegradedLatents::kSplatted;
  int64_t references = 3;  // views beside the degraded one
  ReferenceUnit reference_unit = ReferenceUnit::kSpacing;

  void visit(FieldVisitor& visitor) override;
  void check() const override;
  bool exists() const { return !channels.empty(); }
  bool repairs_samples() const { return exists() && degraded == DegradedLatents::kGenerated; }
  bool repairs_splats() const { return exists() && degraded != DegradedLatents::kGenerated; }
};

}  // namespace gld
