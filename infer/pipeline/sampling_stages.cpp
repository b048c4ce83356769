#include "infer/pipeline/sampling_stages.h"

#include <algorithm>

#include <fmt/format.h>

namespace gld {
namespace {

// Of the stages that run once; a flow has its generator's.
const char* name_of(StageKind kind) {
  switch (kind) {
    case StageKind::kSourceEncoding:
      return "source encoding";
    case StageKind::kViewPairs:
      return "view pairs";
    case StageKind::kSourceWarp:
      return "source warp";
    case StageKind::kPropagation:
      return "propagation";
    case StageKind::kRgbDecoding:
      return "RGB decoding";
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

}  // namespace

bool uses_source_depth(const LevelSet& levels, const StageRequest& request) {
  return request.num_sources > 1 && (request.view_pairs == ViewPairs::kVisible || levels.warped_sources > 0);
}

StageKind source_depth_stage(const StageRequest& request) {
  return request.view_pairs == ViewPairs::kVisible ? StageKind::kViewPairs : StageKind::kSourceWarp;
}

int64_t deepest_encoded_level(const LevelSet& levels, const StageRequest& request) {
  return uses_source_depth(levels, request) ? levels.levels - 1
                                            : std::max(levels.deepest_generated(), levels.boundary);
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
    case StageKind::kViewPairs:
    case StageKind::kSourceWarp:
    case StageKind::kGeometry:
      return ModelKind::kGeometry;
    default:
      return ModelKind::kBackboneOrDecoder;
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
  if (request.view_pairs == ViewPairs::kVisible) {
    stages.push_back(
        stage(StageKind::kViewPairs, depth ? "depth of the source views tells which views see common space"
                                           : "by the cameras alone, one source has no scale"));
  }
  if (levels.warped_sources > 0) {
    stages.push_back(stage(StageKind::kSourceWarp,
                           depth ? "their depth carries the photographs into the target views"
                                 : "nothing is carried into the target views: one source has no scale"));
  }
  for (size_t i = 0; i < levels.generators.size(); ++i) stages.push_back(flow_stage(levels, i));
  stages.push_back(request.decodes() ? stage(StageKind::kPropagation, propagation_reason(levels))
                                     : left_out(StageKind::kPropagation, "only latents were asked for"));
  const auto views_text = [&](DecodedViews which) {
    return which == DecodedViews::kAll ? std::string("all views")
                                       : fmt::format("{} target views", request.decoded_views(which));
  };
  stages.push_back(request.image_views != DecodedViews::kNone
                       ? stage(StageKind::kRgbDecoding, views_text(request.image_views))
                       : left_out(StageKind::kRgbDecoding, "no images were asked for"));
  stages.push_back(request.geometry_views != DecodedViews::kNone
                       ? stage(StageKind::kGeometry, request.geometry_views == DecodedViews::kAll
                                                         ? "all views: the sources tell the scale"
                                                         : "target views")
                       : left_out(StageKind::kGeometry, "no depth, rays or points were asked for"));
  return stages;
}

}  // namespace gld
