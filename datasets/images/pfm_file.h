#pragma once

#include "datasets/images/image.h"

#include <filesystem>

namespace gld {

// Writes a portable float map, one channel, little-endian, rows from bottom to top as the format wants them. Values
// that are not positive and finite are written as 0 (unknown). The file is written atomically; throws Error when the
// map is not width x height.
void write_pfm(const std::filesystem::path& file, const DepthMap& depth);

}  // namespace gld
