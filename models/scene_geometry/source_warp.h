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

// Levels 0..deepest of the target views as a backbone sees the completed pictures beside the source photographs, raw,
// (target views, leading + patch tokens, C).
std::vector<torch::Tensor> encode_completed(const LatentSpace& space, const torch::Tensor& source_images,
                                            const SourceWarp& warp, int64_t deepest);

// Nothing carried.
SourceWarp no_source_warp(const Views& views, int64_t count, const std::string& doubt);

// source_geometry: depth and rays of the source views alone, (sources, height, width ...); source_images: (sources, 3,
// height, width) in [0, 1]. Depth is brought to the unit of the cameras by the rays, or where they leave it open by
// the photographs (geometry_placement.h); where they do not tell it either, as with one source, nothing is carried.
SourceWarp warp_sources(const Views& views, const torch::Tensor& source_images,
                        const GeometryOutput& source_geometry, int64_t count);

}  // namespace gld
