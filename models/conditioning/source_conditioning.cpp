#include "models/conditioning/source_conditioning.h"

#include "models/conditioning/decoder_inputs.h"
#include "models/scene_geometry/source_warp.h"

#include <utility>

namespace gld {

ConditioningNeeds conditioning_needs(const SourceScene& scene, int64_t deepest_shown,
                                     int64_t warped_sources) {
  ConditioningNeeds needs;
  needs.deepest_shown = deepest_shown;
  needs.warped_sources = warped_sources;
  // A single source leaves the unit of the head's depth open.
  const bool has_unit = scene.views.num_sources > 1 || scene.single_source_unit > 0;
  needs.head_depth = !scene.depth && has_unit && warped_sources > 0;
  return needs;
}

int64_t deepest_encoded_level(const ConditioningNeeds& needs, int64_t levels) {
  return needs.head_depth ? levels - 1 : needs.deepest_shown;
}

SourceConditioning encode_sources(const LatentSpace& space, const torch::Tensor& source_images,
                                  const ConditioningNeeds& needs) {
  SourceConditioning sources;
  sources.grid = space.grid_of(source_images.size(0), source_images.size(2), source_images.size(3));
  sources.levels = space.encode(source_images, deepest_encoded_level(needs, space.levels()));
  if (needs.propagation) sources.leading = space.leading_for_propagation(source_images, sources.levels);
  if (needs.head_depth) sources.for_geometry = geometry_inputs(space, sources.levels);
  // Deeper levels than those that are shown are not needed any more.
  sources.levels.resize(static_cast<size_t>(needs.deepest_shown) + 1);
  return sources;
}

GeometryOutput source_geometry(const GeometryHead& head, const SourceConditioning& sources) {
  return head.look(sources.for_geometry, sources.grid, GeometryMaps::kDepthAndRays);
}

WarpedFeatures warp_into_targets(const LatentSpace& space, const SourceScene& scene,
                                 const ConditioningNeeds& needs) {
  const SourceWarp warp = warp_sources(scene.views, scene.images, scene.depth.value(), needs.warped_sources);
  if (!warp.completed.defined()) return {{}, {}, warp.doubt};
  WarpedFeatures warped{warp.agreement, {}, warp.doubt};
  const int64_t sources = scene.images.size(0);
  const auto pictures = torch::cat({scene.images, warp.completed.to(scene.images.options())});
  for (const auto& level : space.encode(pictures, needs.deepest_shown)) {
    warped.levels.push_back(level.slice(0, sources).slice(1, space.leading_tokens()));
  }
  return warped;
}

SourceConditioning condition_on_sources(const LatentSpace& space, const GeometryHead* head,
                                        const SourceScene& scene, const ConditioningNeeds& needs) {
  SourceConditioning sources = encode_sources(space, scene.images, needs);
  SourceScene placed = scene;
  if (needs.head_depth) {
    placed.depth = source_depth_of_head(scene.views, scene.images, source_geometry(*head, sources),
                                        scene.single_source_unit);
  }
  if (needs.warped_sources > 0 && placed.depth) sources.warped = warp_into_targets(space, placed, needs);
  return sources;
}

}  // namespace gld
