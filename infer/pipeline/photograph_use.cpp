#include "infer/pipeline/photograph_use.h"

#include "gld/base/error.h"

namespace gld {

void PhotographOptions::visit(FieldVisitor& visitor) {
  visit_choice(
      visitor,
      {"source_depth",
       "who says how deep the source views are: the model, the photographs where they agree (stereo), or "
       "both (fused), or both mended by the model's own network (refined); automatic: refined where the model "
       "has such a network, fused for other models that are shown photographs in target views, or blend them"},
      source_depth, {"automatic", "model", "stereo", "fused", "refined"});
  visit_choice(
      visitor,
      {"compose",
       "photographs: what they show of a target view is kept and the rest generated; blended: the same, "
       "laid together by the model's own network; none: all is generated; automatic: blended where the "
       "model has such a network, photographs for other models that are shown them"},
      compose, {"automatic", "photographs", "blended", "none"});
  visitor.boolean(
      {"generate_complete",
       "generate also target views that photographs show whole and agree on, of which nothing generated "
       "is needed where photographs are kept"},
      generate_complete);
  visitor.group({"stereo", "how photographs are matched for their depth"}, stereo);
  visitor.real(
      {"depth_error",
       "to see what depends on it: the depth that carries photographs is off by this share, in turns too "
       "far and too near, where it is found and not given; depth that is written is then off as well"},
      depth_error, {0, 0.9});
}

PhotographUse PhotographOptions::use(const PhotographModel& model) const {
  const bool trained_with_photographs = model.warped_sources > 0;
  PhotographUse use;
  use.stereo = stereo;
  use.depth_error = depth_error;
  switch (source_depth) {
    case DepthChoice::kAutomatic:
      if (model.has_depth_refinement) {
        use.depth = SourceDepthOrigin::kRefined;
      } else if (trained_with_photographs || model.has_blending) {
        use.depth = SourceDepthOrigin::kFused;
      }
      break;
    case DepthChoice::kModel:
      break;
    case DepthChoice::kStereo:
      use.depth = SourceDepthOrigin::kStereo;
      break;
    case DepthChoice::kFused:
      use.depth = SourceDepthOrigin::kFused;
      break;
    case DepthChoice::kRefined:
      if (!model.has_depth_refinement) {
        fail({"--source-depth", "model, stereo or fused for a model without a depth_refinement part",
              "refined", "choose one of them, or train the part with gld train depth"});
      }
      use.depth = SourceDepthOrigin::kRefined;
      break;
  }
  if (!model.has_geometry_head && use.depth != SourceDepthOrigin::kHead)
    use.depth = SourceDepthOrigin::kStereo;
  switch (compose) {
    case ComposeChoice::kAutomatic:
      if (model.has_blending) {
        use.composition = Composition::kBlended;
      } else if (trained_with_photographs) {
        use.composition = Composition::kPhotographs;
      }
      break;
    case ComposeChoice::kPhotographs:
      use.composition = Composition::kPhotographs;
      break;
    case ComposeChoice::kBlended:
      if (!model.has_blending) {
        fail({"--compose", "photographs or none for a model without a blending part", "blended",
              "choose one of them, or train the part with gld train blending"});
      }
      use.composition = Composition::kBlended;
      break;
    case ComposeChoice::kNone:
      break;
  }
  use.leaves_out_complete = use.composes() && !generate_complete;
  // Without a head only photographs can say how deep they are.
  if (use.composes() && !model.has_geometry_head) use.depth = SourceDepthOrigin::kStereo;
  return use;
}

}  // namespace gld
