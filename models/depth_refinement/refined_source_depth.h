#pragma once

#include "gld/photogrammetry/photo_consistency.h"
#include "gld/photogrammetry/planar_depth.h"
#include "gld/photogrammetry/view_maps.h"
#include "models/depth_refinement/depth_refinement.h"

#include <cstdint>
#include <vector>

namespace gld {

// Two source views or more with their depth in the unit of the cameras, and who says it.
struct ToldDepth {
  std::vector<PicturedView> photographs;  // of one size
  // How far the photographs confirm it, one a view and of its depth's size; an empty map: not at all.
  std::vector<ConfidenceMap> confidence;
  std::vector<PlanarDepth> head;  // what the geometry head says, in the same unit, of any size; one a view
  // From 0 to 1 this is how far photographs bear the head out here (belief_in_prior()). Where they do not, this place
  // is none of those that head and network have learnt, and half of a correction is taken: the mean of both opinions.
  double belief = 1;
};

// Returns it as the network sees it, in pictures of at most `side` pixels on the longer side.
DepthEvidence depth_evidence(const ToldDepth& told, int64_t side);

// Returns the depth of each view, mended by the network; as large as it was, and not known where it was not. Throws
// Error where the network's output is not finite.
std::vector<PlanarDepth> refined_depths(const DepthRefinement& refinement, const ToldDepth& told);

}  // namespace gld
