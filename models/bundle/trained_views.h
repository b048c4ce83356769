#pragma once

#include "models/bundle/bundle.h"

#include <cstdint>

namespace gld {

// Notes how many views scenes had when a flow model was trained, in the metadata of its file ("gld:trained_views").
void note_trained_views(const ModelBundle& bundle, const BundlePart& part, int64_t views);

// Returns the fewest that a flow model of the bundle was trained with; 0 where none of them says it.
int64_t trained_views(const ModelBundle& bundle);

}  // namespace gld
