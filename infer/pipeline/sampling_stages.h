#pragma once

#include "gld/machine/stage_record.h"
#include "infer/pipeline/photograph_use.h"
#include "models/conditioning/source_conditioning.h"
#include "models/latent_spaces/level_set.h"
#include "models/layers/layer_precision.h"

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// Which views are decoded.
enum class DecodedViews { kNone, kTargets, kAll };

// What a geometry model that looks at finished pictures is told of their cameras: nothing, so that it finds them,
// or those that are given.
enum class GeometryCameras { kFound, kGiven };

// This decides which stages a sampling run has.
struct StageRequest {
  int64_t views = 2;
  int64_t num_sources = 1;
  DecodedViews image_views = DecodedViews::kTargets;
  DecodedViews geometry_views = DecodedViews::kNone;
  bool source_depth_given = false;        // of the source views, before the pipeline runs
  bool single_source_unit_known = false;  // whether the unit of a single source's depth is known
  PhotographUse photographs;
  bool refines_samples = false;

  bool decodes() const { return image_views != DecodedViews::kNone || geometry_views != DecodedViews::kNone; }
  int64_t decoded_views(DecodedViews which) const {
    return which == DecodedViews::kAll ? views : which == DecodedViews::kTargets ? views - num_sources : 0;
  }
};

enum class StageKind {
  kSourceEncoding,
  kSourceDepth,
  kSourceWarp,
  kFlow,
  kSampleRefinement,
  kPropagation,
  kRgbDecoding,
  kComposition,
  kGeometry
};

// Returns what kind its models are of, where they are asked what to compute in. Backbones are float32 as geometry is:
// the depth that carries photographs into target views is of their features, and where it moves a photograph by a
// token, a flow ends elsewhere. In bfloat16 they made 20 times the error of the whole of the flows (configs/tiny: 0.029
// instead of 0.0015), and they take a hundredth of a scene's time.
ModelKind model_kind_of(StageKind kind);

// A stage of sampling: what the planner prices, the forecast sizes, the pipeline runs and reports print.
struct SamplingStage {
  StageKind kind = StageKind::kSourceEncoding;
  size_t generator = 0;  // of kFlow: its number in the level set
  std::string name;      // in records, reports and errors
  bool runs = true;
  std::string reason;  // why it runs or not, in words
};

// Returns all stages in their order, also those that this request leaves out.
std::vector<SamplingStage> sampling_stages(const LevelSet& levels, const StageRequest& request);

// Returns what the stages of a kind took together: with kFlow those of all generators.
double stage_seconds(const LevelSet& levels, StageKind kind, const StageRecords& records);

// Returns whether the depth of the source views is needed, to carry photographs into target views as the model is shown
// them or as they are kept in its pictures; one source view alone leaves its unit open, unless its depth is given or
// its usual unit is known.
bool needs_source_depth(const LevelSet& levels, const StageRequest& request);
// Returns whether finding it is a stage of its own: beside the head's depth, which the warp asks for itself.
bool has_source_depth_stage(const LevelSet& levels, const StageRequest& request);
// Returns whether the geometry head is asked for it.
bool uses_source_depth(const LevelSet& levels, const StageRequest& request);

// Returns whether a network mends it: what several photographs agree on.
bool mends_source_depth(const LevelSet& levels, const StageRequest& request);

// Returns what is encoded of the source views, and to which level.
ConditioningNeeds conditioning_needs(const LevelSet& levels, const StageRequest& request);
int64_t deepest_encoded_level(const LevelSet& levels, const StageRequest& request);

}  // namespace gld
