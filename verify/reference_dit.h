#pragma once

#include "gld/cameras/camera.h"
#include "gld/flow/guidance.h"
#include "gld/flow/solvers/solver.h"
#include "models/dit/dit_dh.h"
#include "models/dit/dit_scene.h"
#include "verify/reference_case.h"

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace gld {

// The configuration of a diffusion model in a reference case: the model's own options, which start from the
// published conventions, and beside them the size of the scene.
struct DitCaseOptions : OptionsGroup {
  DitOptions model;
  int64_t height = 0;  // pixels
  int64_t width = 0;   // pixels
  int64_t num_views = 0;
  int64_t num_sources = 0;

  DitCaseOptions() { apply_published_conventions(model); }
  void visit(FieldVisitor& visitor) override;
  void check() const override;
  LatentGrid grid() const {
    return {num_views, height / model.camera_patch_size, width / model.camera_patch_size};
  }
};

// How a case samples: Euler on the published schedule, with guidance.
struct CaseSamplerOptions : OptionsGroup {
  SolverKind solver = SolverKind::kEuler;
  int64_t num_times = 50;
  double time_shift = 1;
  double last_time = 0.001;
  double guidance_scale = 1;
  std::vector<double> guidance_interval = {0, 1};

  void visit(FieldVisitor& visitor) override;
  SolverOptions solver_options() const;
  GuidanceOptions guidance_options() const;
};

// reference_views returns the inputs "camera_to_world" (views, 4, 4) and "intrinsics" (views, 3, 3) as checked cameras.
// Throws Error where the inputs have another number of views.
struct CaseViewSizes {
  int64_t num_views = 0;
  int64_t num_sources = 0;
  int64_t width = 0;   // pixels
  int64_t height = 0;  // pixels
};
Views reference_views(const ReferenceCase& reference, const CaseViewSizes& sizes);

// Returns an input latent as (views, tokens, channels). Cases hold (views, channels, grid height, grid width), or
// tokens where the model has special ones.
torch::Tensor reference_latent(const ReferenceCase& reference, const std::string& name,
                               const DitCaseOptions& options);
// Does the inverse, for outputs.
torch::Tensor latent_in_case_layout(const torch::Tensor& tokens, const DitCaseOptions& options);

// Returns the scene of a case: cameras, "source_features" (of which the source views' are taken; the target views' are
// zero) and, for cascades, "deeper_level".
DitSceneInputs reference_scene(const ReferenceCase& reference, const DitCaseOptions& options);

// Returns the model with its weights, whose names start with prefix.
std::shared_ptr<DitDh> reference_dit(const ReferenceCase& reference, const DitOptions& options,
                                     const std::string& prefix = "");

}  // namespace gld
