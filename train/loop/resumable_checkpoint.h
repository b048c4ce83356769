#pragma once

#include "gld/base/options.h"
#include "train/loop/checkpoint.h"

#include <map>
#include <string>
#include <vector>

namespace gld {

// Checks everything that a resumed run takes from a checkpoint, so that nothing is half restored and nothing is
// converted without a word: the run's kind, its counts, and the names, shapes and types of the tensors of `like`, a
// checkpoint of the run as it stands. Throws Error, naming `where`.
void check_resumable(const Checkpoint& checkpoint, const Checkpoint& like, const std::string& kind_of_run,
                     const std::string& where);

// Checks the model that a run describes beside its options, as the checkpoint keeps it. Throws Error naming the first
// key that has another value, but for its name and what may_change lists ("model.level1_time_shift.training").
// What the checkpoint's program did not have is as in defaults, such a model as constructed, where
// they are given.
void check_same_model(const Checkpoint& checkpoint, const OptionsGroup& model, const OptionsGroup* defaults,
                      const std::vector<std::string>& may_change, const std::string& where);

// Checks the frozen parts that a run is trained on, SHA-256 by name, as the checkpoint keeps them. Throws Error naming
// the first that is another one.
void check_same_parts(const Checkpoint& checkpoint, const std::map<std::string, std::string>& parts,
                      const std::string& where);

}  // namespace gld
