#pragma once

#include "models/bundle/bundle.h"

namespace gld {

// Returns whether what splats show of latents can be repaired with this bundle: it has a refiner of such latents, with
// weights, and the statistics that it learnt under.
bool has_splat_refiner(const ModelBundle& bundle);

}  // namespace gld
