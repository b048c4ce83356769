#pragma once

#include <cstdint>
#include <vector>

namespace gld {

// Returns a smooth surface through scattered values: values where weights are large are kept, and in between and beyond
// them coarser and coarser means take over (pull and push over a pyramid of halved grids, linear time). values are
// (height, width, channels); weights are (height, width), at least 0 and finite. The surface is all zero where all
// weights are.
std::vector<float> membrane(int64_t width, int64_t height, int64_t channels, const std::vector<float>& values,
                            const std::vector<float>& weights);

}  // namespace gld
