#pragma once

#include "gld/machine/instruction_set.h"
#include "gld/photogrammetry/plane_sweep_stereo.h"
#include "gld/photogrammetry/semi_global_matching.h"
#include "gld/photogrammetry/stereo_picture.h"
#include "gld/photogrammetry/swept_views.h"

#include <cstdint>
#include <vector>

namespace gld {

// Returns depth, confidence, doubt and what is far of all views from what was matched. finest_pixels are those of the
// last pass, in a pixel of these pictures; movement counts in them.
std::vector<StereoDepth> judged_matches(const std::vector<StereoPicture>& pictures,
                                        const std::vector<SweptView>& swept,
                                        const std::vector<MatchedPlanes>& matched, int64_t window_radius,
                                        double finest_pixels, const KernelSettings& settings);

// A window that shows two surfaces gives the one's depth to pixels of the other, in all views alike, so that no other
// check sees it; and what is certain, or far, alone among what is not was matched by chance. What is far has to lie
// beyond what is certain, and is forgotten in a view of which it is less than a hundredth.
void doubt_edges_and_specks(StereoDepth& found, int64_t radius);

}  // namespace gld
