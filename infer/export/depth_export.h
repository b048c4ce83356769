#pragma once

#include "datasets/images/image.h"
#include "datasets/images/png_file.h"
#include "gld/report/provenance.h"

#include <filesystem>
#include <string>
#include <vector>

namespace gld {

// Returns the length of one step of 16-bit depth files that fits all maps of a run: 1, 2 or 5 times a power of ten, at
// least the depth that all but outliers stay below, over 65535. Outliers are values more than four times the 99.5th
// percentile, such as the overflow of an exponential; they saturate. It is 0.001 when no value is known.
double choose_depth_unit(const std::vector<DepthMap>& maps);

// Returns round(depth / unit), from 1 to 65535; 0 where the depth is not known. Throws Error unless unit is positive
// and finite.
Grey16 quantised_depth(const DepthMap& depth, double unit);

// Writes a 16-bit PNG of quantised_depth with the unit as the text "gld:depth_unit" beside the provenance. Writing is
// atomic.
void export_depth_png(const std::filesystem::path& file, const DepthMap& depth, double unit,
                      const Provenance& provenance);

}  // namespace gld
