#pragma once

#include "datasets/images/image.h"
#include "datasets/pictures/colour_map.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// The two ends of the colour map stand for these depths; 0 < nearest < farthest.
struct DepthRange {
  double nearest = 1;
  double farthest = 2;
};

// Returns the 1st and 99th percentile of all known depths, so that a few outliers do not take the colours. A range
// narrower than 2 % is widened to that (all depths equal); {1, 2} when no depth is known.
DepthRange robust_depth_range(const std::vector<DepthMap>& maps);

// Colours depth on a logarithmic scale, near bright and far dark; grey where the depth is not known.
Image coloured_depth(const DepthMap& depth, const DepthRange& range);

// Draws the colour bar of a range, width x 40 pixels, with depths written under it; unit ("m") follows each number and
// may be empty; paper is the background.
Image depth_legend(const DepthRange& range, int64_t width, const std::string& unit, const Rgb& paper);

// Returns coloured_depth with the legend under it; at least 240 pixels wide.
Image depth_preview(const DepthMap& depth, const DepthRange& range, const std::string& unit);

}  // namespace gld
