#pragma once

#include "gld/cameras/camera.h"
#include "gld/photogrammetry/source_depth.h"
#include "models/decoders/geometry_head.h"

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

// Why nothing is known of a single source view's depth where nobody guesses its unit.
inline constexpr const char* kNoScaleOfOneSource = "the depth of a single source view has no scale";

// Returns a geometry head's depth, one map a view, times the length of its unit in that of the cameras.
std::vector<PlanarDepth> depth_in_unit(const GeometryOutput& geometry, int64_t views, double unit);

// Returns what a geometry head says of the source views alone, brought to the unit of the cameras by its rays, or where
// they leave it open by the photographs (geometry_placement.h). It is not known where these do not tell it either: a
// guess carries photographs to wrong places, and as depth moves to where they agree, agreement does not show it.
// source_geometry is depth and rays, (sources, height, width ...); source_images are (sources, 3, height, width) in [0,
// 1]. Nothing tells the unit of a single source. single_source_unit is a guess of it, in the cameras' unit (0: none),
// of what is usual where a model was trained (BundleOptions::unit_of_single_source): of 60 drawn rooms that it is not
// of, the nearest photograph as it is has 15.8 dB, carried so and filled 20.0, in the true unit 21.1. Where there is
// one, source_geometry.single_view takes its place, which knows the view.
SourceDepth source_depth_of_head(const Views& views, const torch::Tensor& source_images,
                                 const GeometryOutput& source_geometry, double single_source_unit);

// source_images are as above. Nothing is carried where the depth is not known.
SourceWarp warp_sources(const Views& views, const torch::Tensor& source_images, const SourceDepth& depth,
                        int64_t count);

// The depth of each target view as that of the source whose camera stands nearest says
// (gld/photogrammetry/picture_warp.h, depth_seen_from()), in the scene's unit, (target views, height, width);
// undefined where it is not known, and then why.
struct NearestSourceDepth {
  torch::Tensor depth;
  std::string doubt;
};
NearestSourceDepth nearest_source_depth(const Views& views, const SourceDepth& depth);

}  // namespace gld
