#pragma once

#include "train/loop/checkpoint.h"

#include <string>

namespace gld {

// Checks everything that a resumed run takes from a checkpoint, so that nothing is half restored and nothing is
// converted without a word: the run's kind, its counts, and the names, shapes and types of the tensors of `like`, a
// checkpoint of the run as it stands. Throws Error, naming `where`.
void check_resumable(const Checkpoint& checkpoint, const Checkpoint& like, const std::string& kind_of_run,
                     const std::string& where);

}  // namespace gld
