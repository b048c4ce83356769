#pragma once

#include "models/bundle/bundle.h"
#include "models/bundle/bundle_options.h"

#include <cstdint>

namespace gld {

// What a stage of sampling has in memory at its peak, in bytes.
struct StageMemory {
  int64_t weights = 0;  // of the modules it loads, whole, as they are kept (packed)
  // Of those the float32 numbers that are all there before the last is packed (ModelBundle::converted_bytes). Others
  // are pages of their file, which leave when they are packed; where the system keeps them (a file that the user may
  // not write), it can take them back at any time and they are not counted.
  int64_t converted = 0;
  int64_t held = 0;     // latents, noise and features that outlive it
  int64_t working = 0;  // activations (models/cost/cost_model.h)
};

// Returns the resident memory of the process at the stage's peak: these, the program itself, the kernels' scratch, and
// freed blocks that wait for the next tensor of their size (gld/machine/block_memory.h). It is within a quarter of what
// was measured with the published sizes at 112x112 to 504x504 and with configs/tiny.
int64_t predicted_peak_bytes(const StageMemory& memory);

// Returns the bytes of all parameters and buffers of that part in float32. It computes nothing and takes no memory.
int64_t weight_bytes_of(const BundlePart& part, const BundleOptions& options);

}  // namespace gld
