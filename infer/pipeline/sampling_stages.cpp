#include "infer/pipeline/sampling_stages.h"

#include "models/scene_geometry/source_warp.h"

#include <algorithm>

#include <fmt/format.h>

namespace gld {
namespace {

// Returns the name of the stages that run once; a flow has its generator's.
const char* name_of(StageKind kind) {
  switch (kind) {
    case StageKind::kSourceEncoding:
      return "source encoding";
    case StageKind::kSourceDepth:
      return "source depth";
    case StageKind::kSourceWarp:
      return "source warp";
    case StageKind::kSampleRefinement:
      return "sample refinement";
    case StageKind::kPropagation:
      return "propagation";
    case StageKind::kRgbDecoding:
      return "RGB decoding";
    case StageKind::kComposition:
      return "composition";
    case StageKind::kGeometry:
      return "geometry";
    case StageKind::kFlow:
      break;
  }
  return "flow";
}

SamplingStage stage(StageKind kind, const std::string& reason) {
  return {kind, 0, name_of(kind), true, reason};
}

SamplingStage left_out(StageKind kind, const std::string& reason) {
  return {kind, 0, name_of(kind), false, reason};
}

SamplingStage flow_stage(const LevelSet& levels, size_t generator) {
  return {StageKind::kFlow, generator, generator_stage(levels.generators[generator]), true, ""};
}

std::string propagation_reason(const LevelSet& levels) {
  const int64_t first = levels.boundary + 1, last = levels.levels - 1;
  if (first > last) return "no deeper level; the generated ones are normalised for the decoders";
  const std::string which =
      first == last ? fmt::format("level {}", last)
                    : fmt::format("levels {} {} {}", first, last == first + 1 ? "and" : "to", last);
  return which + " of all views, which attend to each other";
}

std::string source_depth_reason(const StageRequest& request) {
  if (request.source_depth_given) return "given";
  if (request.num_sources == 1) return "the geometry head's, in a unit that the model guesses";
  switch (request.photographs.depth) {
    case SourceDepthOrigin::kStereo:
      return "what the photographs agree on";
    case SourceDepthOrigin::kFused:
      return "what the photographs agree on, with the geometry head's depth as prior";
    case SourceDepthOrigin::kRefined:
      return "what the photographs agree on, with the geometry head's depth as prior, mended by a network";
    case SourceDepthOrigin::kHead:
      break;
  }
  return "the geometry head's";
}

}  // namespace

bool has_source_depth_stage(const LevelSet& levels, const StageRequest& request) {
  return (request.photographs.matches() || request.photographs.composes()) &&
         needs_source_depth(levels, request);
}

bool needs_source_depth(const LevelSet& levels, const StageRequest& request) {
  const bool composes = request.photographs.composes() && request.image_views != DecodedViews::kNone;
  const bool guessed =
      request.single_source_unit_known && request.photographs.depth != SourceDepthOrigin::kStereo;
  const bool has_unit = request.num_sources > 1 || request.source_depth_given || guessed;
  return has_unit && (levels.warped_sources > 0 || composes);
}

bool uses_source_depth(const LevelSet& levels, const StageRequest& request) {
  return !request.source_depth_given && request.photographs.depth != SourceDepthOrigin::kStereo &&
         needs_source_depth(levels, request);
}

bool mends_source_depth(const LevelSet& levels, const StageRequest& request) {
  return request.photographs.refines() && request.num_sources > 1 && uses_source_depth(levels, request);
}

ConditioningNeeds conditioning_needs(const LevelSet& levels, const StageRequest& request) {
  ConditioningNeeds needs;
  needs.deepest_shown = levels.deepest_generated();
  needs.warped_sources = levels.warped_sources;
  needs.head_depth = uses_source_depth(levels, request);
  needs.propagation = request.decodes();
  return needs;
}

int64_t deepest_encoded_level(const LevelSet& levels, const StageRequest& request) {
  return deepest_encoded_level(conditioning_needs(levels, request), levels.levels);
}

double stage_seconds(const LevelSet& levels, StageKind kind, const StageRecords& records) {
  std::vector<std::string> names;
  if (kind == StageKind::kFlow) {
    for (const LevelGenerator& generator : levels.generators) names.push_back(generator_stage(generator));
  } else {
    names.emplace_back(name_of(kind));
  }
  double seconds = 0;
  for (const auto& record : records.records()) {
    if (std::find(names.begin(), names.end(), record.name) != names.end()) seconds += record.seconds;
  }
  return seconds;
}

ModelKind model_kind_of(StageKind kind) {
  switch (kind) {
    case StageKind::kFlow:
      return ModelKind::kGenerator;
    case StageKind::kSourceEncoding:
    case StageKind::kPropagation:
    case StageKind::kSourceDepth:
    case StageKind::kSourceWarp:
    case StageKind::kGeometry:
    case StageKind::kSampleRefinement:
    case StageKind::kComposition:  // convolutions alone
      return ModelKind::kLeanedOn;
    default:
      return ModelKind::kRunOnce;
  }
}

std::vector<SamplingStage> sampling_stages(const LevelSet& levels, const StageRequest& request) {
  const bool depth = uses_source_depth(levels, request);
  std::vector<SamplingStage> stages;
  stages.push_back(
      stage(StageKind::kSourceEncoding,
            depth ? fmt::format("{} source views up to the last level, for their depth", request.num_sources)
                  : fmt::format("{} source views up to level {}; deeper blocks are not needed",
                                request.num_sources, deepest_encoded_level(levels, request))));
  if (has_source_depth_stage(levels, request)) {
    stages.push_back(stage(StageKind::kSourceDepth, source_depth_reason(request)));
  }
  if (levels.warped_sources > 0) {
    stages.push_back(stage(StageKind::kSourceWarp,
                           needs_source_depth(levels, request)
                               ? "their depth carries the photographs into the target views"
                               : "nothing is carried into the target views: one source has no scale"));
  }
  for (size_t i = 0; i < levels.generators.size(); ++i) stages.push_back(flow_stage(levels, i));
  if (request.refines_samples)
    stages.push_back(
        stage(StageKind::kSampleRefinement,
              "what the flows made of the target views, each in one call beside the source views"));
  stages.push_back(request.decodes() ? stage(StageKind::kPropagation, propagation_reason(levels))
                                     : left_out(StageKind::kPropagation, "only latents were asked for"));
  const auto views_text = [&](DecodedViews which) {
    return which == DecodedViews::kAll ? std::string("all views")
                                       : fmt::format("{} target views", request.decoded_views(which));
  };
  stages.push_back(request.image_views != DecodedViews::kNone
                       ? stage(StageKind::kRgbDecoding, views_text(request.image_views))
                       : left_out(StageKind::kRgbDecoding, "no images were asked for"));
  if (request.photographs.composes() && request.image_views != DecodedViews::kNone) {
    stages.push_back(needs_source_depth(levels, request)
                         ? stage(StageKind::kComposition,
                                 request.photographs.blends()
                                     ? "what photographs show of the target views is kept, blended by "
                                       "the model"
                                     : "what photographs show of the target views is kept")
                         : left_out(StageKind::kComposition, kNoScaleOfOneSource));
  }
  stages.push_back(request.geometry_views != DecodedViews::kNone
                       ? stage(StageKind::kGeometry, request.geometry_views == DecodedViews::kAll
                                                         ? "all views: the sources tell the scale"
                                                         : "target views")
                       : left_out(StageKind::kGeometry, "no depth, rays or points were asked for"));
  return stages;
}

}  // namespace gld
