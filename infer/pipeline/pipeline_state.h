#pragma once

#include "gld/photogrammetry/source_depth.h"
#include "models/conditioning/source_conditioning.h"
#include "models/scene_geometry/photograph_depth.h"

#include <cstdint>
#include <map>
#include <optional>

#include <torch/types.h>

namespace gld {

// The stages hand this on to each other.
struct PipelineState {
  SourceConditioning sources;
  std::optional<SourceDepth> depth;
  SourcePhotographs photographs;             // where the request has none
  std::map<int64_t, torch::Tensor> latents;  // normalised, on the device
};

}  // namespace gld
