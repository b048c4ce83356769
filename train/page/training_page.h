#pragma once

#include "gld/page/page.h"

#include <cstdint>
#include <filesystem>

namespace gld {

// Returns the page of a run of gld train from its folder: how losses, validation and learning rate went
// (metrics.jsonl), pictures of the first and the last validations, and what report.json says.
Page training_page(const std::filesystem::path& run);

enum class UnfinishedTraining { kGoesOn, kStopped };

// Returns the same of a run that is not over, without report.json: how far progress.json says that it is. The page of
// one that goes on loads itself again every kTrainingPageSeconds, and its writer writes it as often.
Page unfinished_training_page(const std::filesystem::path& run, UnfinishedTraining state);
inline constexpr int64_t kTrainingPageSeconds = 60;

}  // namespace gld
