#pragma once

#include "gld/page/page.h"

#include <filesystem>

namespace gld {

// Makes the page of a run of gld eval from its folder: means with intervals, plots over scenes, and the sheets of
// scenes.
Page evaluation_page(const std::filesystem::path& run);

}  // namespace gld
