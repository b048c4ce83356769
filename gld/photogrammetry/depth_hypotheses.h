#pragma once

#include "gld/photogrammetry/photograph_composition.h"

#include <array>
#include <cstddef>
#include <vector>

namespace gld {

// A target view as photographs would show it were its depth so many times what was matched: where the match is wrong,
// one of these is nearer to the truth. models/blending chooses between them, and models/depth_refinement sees in a
// source view how the others show it.

// Close together about 1, where most errors of a match are.
constexpr std::array<double, 11> kDepthFactors = {0.74, 0.82, 0.89, 0.94, 0.97, 1.0,
                                                  1.03, 1.06, 1.13, 1.22, 1.35};
// Hypotheses are asked of these: the photographs whose cameras stand nearest to the target's. One that is farther adds
// little but its errors.
constexpr size_t kHypothesisPhotographs = 2;
PlacedPhotographs nearest_photographs(const PlacedPhotographs& placed);

// Of (height, width) pixels.
struct DepthHypothesis {
  std::vector<float> rgb;  // (height, width, 3): mean over the photographs that show it; 0 where none does
  std::vector<float> disagreement;  // mean absolute difference from that mean; 0 where fewer than two show it
  std::vector<float> shown;  // how many of the photographs show it, as a share of kHypothesisPhotographs
};

// placed is what nearest_photographs() leaves of it, at least one photograph.
DepthHypothesis depth_hypothesis(const PlacedPhotographs& placed, double factor);

}  // namespace gld
