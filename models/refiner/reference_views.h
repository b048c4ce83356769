#pragma once

#include "gld/cameras/camera.h"

#include <cstdint>
#include <vector>

namespace gld {

// What distances between cameras are measured in when references are chosen.
enum class ReferenceUnit {
  kSpacing,  // the mean distance of a camera from the one nearest to it: the same for a scene of any unit
  kScene,    // the scene's own unit (Splatent's code)
};

// The views among `candidates` whose cameras are nearest, nearest first, by |p - p'| + |R - R'|_F / 2 with p the centre
// and R the rotation of a camera; ties in the order given. At most `count` of them.
std::vector<int64_t> nearest_references(const Camera& of, const std::vector<Camera>& candidates,
                                        int64_t count, ReferenceUnit unit);

}  // namespace gld
