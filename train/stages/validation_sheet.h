#pragma once

#include "train/loop/objective.h"

#include <filesystem>

namespace gld {

// Draws the pictures of a training run's validation into file.png.
void draw_validation_sheet(const Validation& validation, const std::filesystem::path& file_without_ending);

}  // namespace gld
