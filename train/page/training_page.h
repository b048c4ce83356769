#pragma once

#include "gld/page/page.h"

#include <filesystem>

namespace gld {

// The page of a run of gld train from its folder: how losses, validation and learning rate went (metrics.jsonl),
// pictures of the first and the last validations, and what report.json says.
Page training_page(const std::filesystem::path& run);

}  // namespace gld
