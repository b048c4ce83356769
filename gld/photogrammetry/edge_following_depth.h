#pragma once

#include "gld/photogrammetry/photo_consistency.h"
#include "gld/photogrammetry/planar_depth.h"
#include "gld/photogrammetry/view_maps.h"

namespace gld {

// Returns depth whose edges lie where the picture has edges. Networks, and matches of windows, smear depth across the
// outline of a thing, and a photograph that is carried by smeared depth is torn there. Each logarithm of depth becomes
// the median of those around it, weighted by how near they are and how alike in colour (the joint weighted median
// filter of Ma, He, Wei, Sun and Wu, ICCV 2013), twice. A pixel moves in so far as photographs do not confirm it, not
// at all where they do by half, and only where the median is some hundredths away: what differs by less is a slope, not
// an edge. Pixels whose depth is not known stay so, and are not asked. picture is the view's, of any size, covering the
// depth evenly. confirmed is of the depth's size, in [0, 1], or empty for not at all. Any number of threads gives the
// same bits.
PlanarDepth edge_following_depth(const PlanarDepth& depth, const PicturedView& picture,
                                 const ConfidenceMap& confirmed, int threads);

}  // namespace gld
