#pragma once

#include "train/data/kept_folder.h"
#include "train/data/training_scene.h"

#include <optional>

namespace gld {

// These make of a micro-batch what a KeptFolder keeps, and back, to the bit: pictures as the bytes that they were. The
// second returns nothing for what the first did not make. Scenes are on the CPU and were not splatted.
KeptThing kept_batch(const TrainingBatch& batch);
std::optional<TrainingBatch> batch_of(const KeptThing& kept, int64_t index);

}  // namespace gld
