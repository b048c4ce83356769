#include "train/objectives/frozen_parts.h"

#include "gld/base/error.h"
#include "gld/flow/guidance.h"
#include "models/conditioning/decoder_inputs.h"
#include "models/dit/dit_field.h"
#include "train/objectives/source_view_depth.h"

#include <limits>
#include <utility>

#include <torch/autograd.h>

namespace gld {

void visit_carried_by(FieldVisitor& visitor, CarryingDepth& carried_by) {
  visit_choice(
      visitor,
      {"carried_by",
       "whose depth carries photographs into target views: the geometry head's alone, or what gld sample "
       "takes, which photographs agree on"},
      carried_by, {"head", "photographs"});
}

void check_carried_by(CarryingDepth carried_by, torch::Device device) {
  if (carried_by != CarryingDepth::kPhotographs || device.is_cpu()) return;
  fail({"objective.carried_by", "head on a GPU: photographs are matched on the CPU", "photographs",
        "train with --device cpu, or leave it out"});
}

SourceConditioning condition_on_scene_sources(const FrozenParts& frozen, const BundleOptions& model,
                                              CarryingDepth carried_by, const TrainingScene& scene,
                                              int64_t deepest_shown, int64_t warped_sources) {
  const torch::NoGradGuard no_grad;
  SourceScene given{scene.views, scene.images.narrow(0, 0, scene.views.num_sources), {}};
  given.single_source_unit = model.unit_of_single_source(scene.views, scene.metric);
  if (carried_by == CarryingDepth::kPhotographs && warped_sources > 0) {
    SourceDepth depth =
        sampled_source_depth(*frozen.space, *frozen.geometry_head, frozen.depth_refinement.get(), scene,
                             photographs_of_images(given.views, given.images), given.single_source_unit);
    if (depth.known()) given.depth = std::move(depth);
  }
  return condition_on_sources(*frozen.space, frozen.geometry_head.get(), given,
                              conditioning_needs(given, deepest_shown, warped_sources));
}

torch::Tensor generated_level(const DitDh& dit, const DitSceneInputs& shown, const torch::Tensor& noise,
                              const SolverOptions& solver, double guidance_scale) {
  DitField field(dit, dit.prepare_scene(shown));
  GuidanceOptions guidance;
  guidance.guidance_scale = guidance_scale;
  GuidedField guided(field, guidance);
  const auto solved = try_solve_on(guided, noise, solver, solver_times(solver));
  return solved.failure ? torch::full_like(noise, std::numeric_limits<double>::quiet_NaN()) : solved.state;
}

torch::Tensor decoded_views(const FrozenParts& frozen, const BundleOptions& model, const TrainingScene& scene,
                            const std::map<int64_t, torch::Tensor>& raw) {
  const LatentGrid grid = model.backbone.grid_of(scene.views.size(), scene.height(), scene.width());
  const auto leading = frozen.space->leading_for_propagation(scene.images.narrow(0, 0, 1));
  const auto levels = frozen.space->complete(raw, leading, grid).patches;
  return frozen.rgb_decoder->decode(image_features(levels, model.level_set().decoded_levels()), grid);
}

}  // namespace gld
