#pragma once

#include "infer/verify/reference_case.h"

namespace gld {

// The kind "train_diffusion": it needs training as well as the comparison of infer/, so the two meet here.
NamedTensors run_train_diffusion_case(const ReferenceCase& reference);

// Every kind of reference case.
ReferenceRunners all_reference_runners();

}  // namespace gld
