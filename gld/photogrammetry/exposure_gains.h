#pragma once

#include "gld/cameras/camera.h"
#include "gld/photogrammetry/photo_consistency.h"

#include <array>
#include <vector>

namespace gld {

// A factor for each colour.
using ColourGains = std::array<float, 3>;

// Returns what each photograph's colours are multiplied by so that all of them show the same places in the same
// brightness; their geometric mean over the photographs is 1. Of pixels that two photographs show by the depth of one
// of them the median ratio counts; the gain is exactly 1 where photographs share too little, or differ by less than
// they scatter.
std::vector<ColourGains> exposure_gains(const std::vector<PicturedView>& sources);

// Returns the photographs in the brightness that the target view has; gains has one a source.
std::vector<PicturedView> evened_photographs(const std::vector<PicturedView>& sources,
                                             const std::vector<ColourGains>& gains, const Camera& target);

}  // namespace gld
