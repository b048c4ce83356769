#pragma once

#include "gld/page/page.h"

#include <filesystem>

namespace gld {

// Makes the page of a run of gld ablate from its folder: the claims with their verdicts first, means of the variants,
// the plot, and what each stage took.
Page ablation_page(const std::filesystem::path& run);

}  // namespace gld
