#pragma once

#include "gld/photogrammetry/plane_sweep_stereo.h"
#include "gld/photogrammetry/source_depth.h"

namespace gld {

// Returns what a match of photographs says of all source views' depth, in the unit of their cameras; `from` is left to
// the caller. Depth is not known where hardly any pixel is confident: then photographs say nothing, and a prior's unit
// is open.
SourceDepth matched_source_depth(const StereoScene& stereo);

}  // namespace gld
