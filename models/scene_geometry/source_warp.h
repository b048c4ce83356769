#pragma once

#include "gld/cameras/camera.h"
#include "models/decoders/geometry_head.h"
#include "models/latent_spaces/latent_space.h"

#include <cstdint>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// The photographs of source views carried into the target views by their depth (`warped_sources` of a DiT^DH; the
// conditioning of MVGenMaster, which Table 14 of the paper compares with).
struct SourceWarp {
  // (target views, count, height, width), float32, on the CPU: of `count` photographs a target view, how far each
  // agrees with all of them at a pixel, from 0, where it does not show it, to 1. Those first that are seen from the
  // nearest place and cover the most of the view; zero where there are fewer.
  torch::Tensor agreement;
  // (target views, 3, height, width) in [0, 1]: the mean of all that was carried to each pixel, and that of the
  // nearest pixel where nothing was, so that a backbone can look at it; undefined where nothing was carried.
  torch::Tensor completed;
  std::string doubt;  // why nothing was carried; empty where something was
};

// What the geometry head takes of source views that were encoded up to the last level.
GeometryInputs geometry_inputs(const LatentSpace& space, const SourceLatents& sources);

// source_geometry: depth and rays of the source views alone, (sources, height, width ...); source_images: (sources, 3,
// height, width) in [0, 1]. Depth is brought to the unit of the cameras by the rays, or where they leave it open by
// the photographs (geometry_placement.h); where they do not tell it either, as with one source, nothing is carried: a
// guess carries photographs to wrong places, and as depth moves to where they agree, agreement does not show it.
SourceWarp warp_sources(const Views& views, const torch::Tensor& source_images,
                        const GeometryOutput& source_geometry, int64_t count);

// The depth of each target view as that of the source whose camera stands nearest says (gld/cameras/picture_warp.h,
// depth_seen_from()), in the scene's unit, (target views, height, width); undefined where the unit is not known, and
// then why. What else as for warp_sources.
struct NearestSourceDepth {
  torch::Tensor depth;
  std::string doubt;
};
NearestSourceDepth nearest_source_depth(const Views& views, const torch::Tensor& source_images,
                                        const GeometryOutput& source_geometry);

// What the generators of a scene are shown of its source photographs in the target views.
struct CarriedSources {
  torch::Tensor agreement;  // SourceWarp's; undefined where nothing was carried
  // Patch tokens of levels 0 to the deepest that was asked for, as the backbone sees the completed pictures beside the
  // source photographs, (target views, patch tokens, C), raw; none where nothing was carried.
  std::vector<torch::Tensor> levels;
  std::string doubt;  // SourceWarp's
};

// How much of it the generators take.
struct CarriedSourcesNeeds {
  int64_t warped_sources = 0;  // the most that one of them takes
  int64_t deepest = 0;         // level
};

// Carries, and encodes what was carried. source_images: (sources, 3, height, width) in [0, 1] on the device of the
// space's backbone; source_geometry as for warp_sources.
CarriedSources carry_sources(const LatentSpace& space, const Views& views, const torch::Tensor& source_images,
                             const GeometryOutput& source_geometry, const CarriedSourcesNeeds& needs);

}  // namespace gld
