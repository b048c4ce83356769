#pragma once

#include "models/blending/photograph_blending.h"

namespace gld {

// Lays a target view together by the network: colours of what photographs show of it (view.shown()) change, in pictures
// larger than the network looks at by what it chose in smaller ones. placed and view are of all photographs, as
// view_from_photographs() has them. The variance of a pixel's error is its mixture's: the mean of what was chosen and
// how far that is apart. What is not shown stays so.
void blend_photographs(const PhotographBlending& blending, const PlacedPhotographs& placed,
                       PhotographView& view);

}  // namespace gld
