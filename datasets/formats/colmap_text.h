#pragma once

#include "datasets/formats/colmap_model.h"

#include <filesystem>

namespace gld {

// Reads cameras.txt, images.txt and points3D.txt (the last may be missing).
ColmapModel read_colmap_text(const std::filesystem::path& folder);
void write_colmap_text(const std::filesystem::path& folder, const ColmapModel& model);

}  // namespace gld
