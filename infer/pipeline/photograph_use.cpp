#include "infer/pipeline/photograph_use.h"

namespace gld {

void PhotographOptions::visit(FieldVisitor& visitor) {
  visit_choice(
      visitor,
      {"source_depth",
       "who says how deep the source views are: the model, the photographs where they agree (stereo), or "
       "both (fused); automatic: fused for models that are shown photographs in target views"},
      source_depth, {"automatic", "model", "stereo", "fused"});
  visit_choice(visitor,
               {"compose",
                "photographs: what they show of a target view is kept and the rest generated; none: all is "
                "generated; automatic: photographs for models that are shown them"},
               compose, {"automatic", "photographs", "none"});
  visitor.boolean(
      {"generate_complete",
       "generate also target views that photographs show whole and agree on, of which nothing generated "
       "is needed where photographs are kept"},
      generate_complete);
  visitor.group({"stereo", "how photographs are matched for their depth"}, stereo);
}

PhotographUse PhotographOptions::use(int64_t warped_sources, bool has_geometry_head) const {
  const bool trained_with_photographs = warped_sources > 0;
  PhotographUse use;
  use.stereo = stereo;
  switch (source_depth) {
    case DepthChoice::kAutomatic:
      use.depth = trained_with_photographs ? SourceDepthOrigin::kFused : SourceDepthOrigin::kHead;
      break;
    case DepthChoice::kModel:
      break;
    case DepthChoice::kStereo:
      use.depth = SourceDepthOrigin::kStereo;
      break;
    case DepthChoice::kFused:
      use.depth = SourceDepthOrigin::kFused;
      break;
  }
  if (!has_geometry_head && use.depth != SourceDepthOrigin::kHead) use.depth = SourceDepthOrigin::kStereo;
  const bool composes = compose == ComposeChoice::kAutomatic ? trained_with_photographs
                                                             : compose == ComposeChoice::kPhotographs;
  use.composition = composes ? Composition::kPhotographs : Composition::kNone;
  use.leaves_out_complete = composes && !generate_complete;
  // Without a head only photographs can say how deep they are.
  if (use.composes() && !has_geometry_head) use.depth = SourceDepthOrigin::kStereo;
  return use;
}

}  // namespace gld
