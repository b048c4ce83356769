#pragma once

#include "gld/base/options.h"
#include "gld/photogrammetry/plane_sweep_stereo.h"

#include <string>
#include <vector>

namespace gld {

// Who says how deep the source views are.
enum class SourceDepthOrigin {
  kHead,
  kStereo,  // the photographs
  kFused,   // both
  kRefined  // both, mended by the model's network
};

// Whether what photographs show of a target view is kept in its picture.
enum class Composition {
  kNone,
  kPhotographs,  // laid together by rule
  kBlended       // laid together by the model's network
};

// What a run makes of the photographs beside showing them to the model. The defaults are the published sampler's.
struct PhotographUse {
  SourceDepthOrigin depth = SourceDepthOrigin::kHead;
  Composition composition = Composition::kNone;
  // Target views that photographs show whole are not generated (complete_targets()), unless latents are asked for.
  bool leaves_out_complete = false;
  StereoOptions stereo;  // of all but kHead
  // Depth that is found here, and not given, carries photographs off by so much on purpose (with_depth_error()); what
  // photographs are matched for beside that is not touched. Depth that is fused with that depth and written is off too.
  double depth_error = 0;

  bool matches() const { return depth != SourceDepthOrigin::kHead; }
  bool refines() const { return depth == SourceDepthOrigin::kRefined; }
  bool composes() const { return composition != Composition::kNone; }
  bool blends() const { return composition == Composition::kBlended; }
};

// What of a model decides on that.
struct PhotographModel {
  // It takes so many photographs in each target view; where this is 0, it was trained without, and its sampling stays
  // as it was published unless the options say otherwise.
  int64_t warped_sources = 0;
  bool has_geometry_head = false;
  bool has_blending = false;          // trained, and on the depth of photographs and head together
  bool has_depth_refinement = false;  // likewise
};

// The same as options; what is automatic, the model decides.
struct PhotographOptions : OptionsGroup {
  enum class DepthChoice { kAutomatic, kModel, kStereo, kFused, kRefined };
  enum class ComposeChoice { kAutomatic, kPhotographs, kBlended, kNone };

  DepthChoice source_depth = DepthChoice::kAutomatic;
  ComposeChoice compose = ComposeChoice::kAutomatic;
  bool generate_complete = false;
  StereoOptions stereo;
  double depth_error = 0;

  void visit(FieldVisitor& visitor) override;

  // Throws Error where the model has not what is asked of it.
  PhotographUse use(const PhotographModel& model) const;
};

}  // namespace gld
