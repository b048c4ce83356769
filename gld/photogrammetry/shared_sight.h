#pragma once

#include "gld/photogrammetry/photo_consistency.h"

#include <cstdint>
#include <vector>

namespace gld {

// Returns which pixels of each view another one shows as well, (height, width) of its depth: where the point that the
// pixel sees, by the view's own depth, lies before the other camera, inside of its picture and not behind what that
// view sees there, by more than kSightTolerance of its distance. Matching can find the depth of these alone; of the
// others only what a picture is usually of tells it. Pixels whose depth is not known are in nobody else's sight. views
// have depth in the unit of the cameras.
std::vector<std::vector<uint8_t>> in_sight_of_others(const std::vector<PicturedView>& views);

// Neighbouring pixels of a slanted surface differ by as much.
constexpr double kSightTolerance = 0.04;

}  // namespace gld
