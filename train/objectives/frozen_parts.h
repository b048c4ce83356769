#pragma once

#include "gld/base/options.h"
#include "gld/flow/solvers/solver.h"
#include "gld/latents/level_statistics.h"
#include "models/bundle/bundle.h"
#include "models/conditioning/source_conditioning.h"
#include "models/depth_refinement/depth_refinement.h"
#include "models/dit/dit_dh.h"
#include "models/dit/dit_scene.h"
#include "models/latent_spaces/latent_space.h"
#include "train/data/training_scene.h"

#include <cstdint>
#include <map>
#include <memory>

#include <torch/types.h>

namespace gld {

// Whose depth of the source views carries their photographs into target views.
enum class CarryingDepth {
  kHead,        // the geometry head's, brought to the cameras' unit
  kPhotographs  // what gld sample takes: the photographs' match with the head as prior, mended where a bundle can
};
void visit_carried_by(FieldVisitor& visitor, CarryingDepth& carried_by);
// Throws Error, naming objective.carried_by, where photographs would be matched on a GPU.
void check_carried_by(CarryingDepth carried_by, torch::Device device);

// What an objective of generated latents needs beside the model it trains; nothing here is changed.
struct FrozenParts {
  std::shared_ptr<const LatentSpace> space;
  LevelStatistics statistics;                       // of the level that a flow model learns to generate
  LevelStatistics deeper_statistics;                // of the level that a cascade starts from
  std::shared_ptr<const ImageDecoder> rgb_decoder;  // for validation pictures; may be null
  std::shared_ptr<GeometryHead> geometry_head;      // for warped_sources; null for models that take none
  std::shared_ptr<DepthRefinement>
      depth_refinement;  // for CarryingDepth::kPhotographs, where the bundle has one
};

// Returns what generators of levels up to deepest_shown that take so many photographs in each target view are shown of
// a scene's source views.
SourceConditioning condition_on_scene_sources(const FrozenParts& frozen, const BundleOptions& model,
                                              CarryingDepth carried_by, const TrainingScene& scene,
                                              int64_t deepest_shown, int64_t warped_sources);

// Returns the level that a model generates from this noise. What it gives is not a number throughout where the solve
// meets values that are not finite; Ctrl-C does not end it: training goes on to its checkpoint.
torch::Tensor generated_level(const DitDh& dit, const DitSceneInputs& shown, const torch::Tensor& noise,
                              const SolverOptions& solver, double guidance_scale);

// Decodes all views of a scene to images (views, 3, height, width). raw are levels by number; what neither gives nor
// propagates is zero. frozen.rgb_decoder is there.
torch::Tensor decoded_views(const FrozenParts& frozen, const BundleOptions& model, const TrainingScene& scene,
                            const std::map<int64_t, torch::Tensor>& raw);

}  // namespace gld
