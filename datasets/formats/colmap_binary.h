#pragma once

#include "datasets/formats/colmap_model.h"

#include <filesystem>

namespace gld {

// cameras.bin, images.bin and points3D.bin (the last may be missing); little-endian.
ColmapModel read_colmap_binary(const std::filesystem::path& folder);
void write_colmap_binary(const std::filesystem::path& folder, const ColmapModel& model);

}  // namespace gld
