#pragma once

#include "gld/machine/matrix_unit.h"
#include "train/loop/objective.h"

namespace gld {

// Has the objective's model learn in that precision. Throws Error where its device does not compute it, and on the CPU
// where nothing that is trained follows it: the option would have no effect.
void set_training_precision(Objective& objective, ComputePrecision precision);

}  // namespace gld
