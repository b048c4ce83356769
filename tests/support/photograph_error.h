#pragma once

#include "gld/photogrammetry/photograph_composition.h"

#include <cmath>
#include <cstddef>
#include <vector>

namespace gld::test {

// Returns the mean absolute difference of colours from truth, (height, width, 3), where the view shows something.
inline double mean_error(const PhotographView& view, const std::vector<float>& truth) {
  double sum = 0, count = 0;
  for (size_t pixel = 0; pixel < view.variance.size(); ++pixel) {
    if (!view.shown(pixel)) continue;
    for (size_t c = 0; c < 3; ++c) sum += std::abs(view.rgb[3 * pixel + c] - truth[3 * pixel + c]);
    count += 3;
  }
  return sum / count;
}

}  // namespace gld::test
