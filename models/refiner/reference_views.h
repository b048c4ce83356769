#pragma once

#include "gld/cameras/camera.h"
#include "models/refiner/refiner_options.h"

#include <cstdint>
#include <vector>

namespace gld {

// Returns the views among `candidates` whose cameras are nearest, nearest first, by |p - p'| + |R - R'|_F / 2 with p
// the centre and R the rotation of a camera; ties are in the order given. They are at most `count`.
std::vector<int64_t> nearest_references(const Camera& of, const std::vector<Camera>& candidates,
                                        int64_t count, ReferenceUnit unit);

}  // namespace gld
