#pragma once

#include "models/decoders/geometry_head_registry.h"

namespace gld {

// Whether a bundle's geometry head predicts rays, and with them cameras: all do but VGGT's without its camera head.
// Depth without rays has no place in a scene (infer/pipeline/geometry_placement.h). False where there is no head.
bool predicts_rays(const GeometryHeadOptions& head);

}  // namespace gld
