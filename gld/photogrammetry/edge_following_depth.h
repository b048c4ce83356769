#pragma once

#include "gld/photogrammetry/photo_consistency.h"
#include "gld/photogrammetry/planar_depth.h"
#include "gld/photogrammetry/view_maps.h"

namespace gld {

// Depth whose edges lie where the picture has edges. Networks, and matches of windows, smear depth across the outline
// of a thing, and a photograph that is carried by smeared depth is torn there. Each logarithm of depth becomes the
// median of those around it, weighted by how near they are and how alike in colour (the joint weighted median filter
// of Ma, He, Wei, Sun and Wu, ICCV 2013), twice; as far as photographs confirm a pixel, it keeps its own. A median
// takes one of the depths that are there: nothing in between is made up. Pixels whose depth is not known stay so, and
// are not asked.
// picture: the view's, of any size, covering the depth evenly. confirmed: of the depth's size, or empty for not at
// all.
PlanarDepth edge_following_depth(const PlanarDepth& depth, const PicturedView& picture,
                                 const ConfidenceMap& confirmed, int threads);

}  // namespace gld
