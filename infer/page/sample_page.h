#pragma once

#include "gld/page/page.h"
#include "infer/page/page_options.h"

#include <filesystem>

namespace gld {

// The folder holds truth/NAME.png of a run folder: what a target view should look like.
inline constexpr const char* kTruthFolder = "truth";

// Makes the page of a run of gld sample from its folder alone (docs/PAGE.md): report.json must be there; a picture,
// depth map or cloud that is missing, damaged or outside of the folder is left out, and a doubt says so. The same
// folder gives the same page.
Page sample_page(const std::filesystem::path& run, const PageOptions& options);

}  // namespace gld
